"""Make the README's picture: part of an overlay of the sample data.

contactimg process sample_data/sa_plus -o run && contactimg overlay run -o compared
python benchmarks/readme_picture.py compared/overlays/frame_6.tif.png docs/figures/overlay.png
"""

import sys
from pathlib import Path

import cv2


def main(source: str, target: str) -> None:
    picture = cv2.imread(source)
    rows, columns = picture.shape[:2]
    part = picture[int(0.3 * rows) : int(0.62 * rows), int(0.3 * columns) : int(0.78 * columns)]
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(target, part, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(*sys.argv[1:3])
