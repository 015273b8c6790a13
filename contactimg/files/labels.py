"""Label images: the pixels of each contact hold its label."""

from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray

from contactimg.files.atomic import replacing


def label_image(contacts: pd.DataFrame, shape: tuple[int, ...]) -> NDArray[np.uint16] | NDArray[np.uint32]:
    """The label of the contact in which the centre of each pixel lies, 0 in none.

    Where contacts overlap, they share along the line through the crossings of their rims. A contact without
    the centre of a pixel gets the nearest pixel.

    Examples
    --------
    >>> contacts = pd.DataFrame({"label": [7], "x_px": [2.0], "y_px": [1.0], "radius_px": [1.1]})
    >>> label_image(contacts, (3, 4)).tolist()
    [[0, 0, 7, 0], [0, 7, 7, 7], [0, 0, 7, 0]]
    """
    highest = int(contacts["label"].max()) if len(contacts) else 0
    labels = np.zeros(shape, np.uint16 if highest < 2**16 else np.uint32)
    power = np.full(shape, np.inf, np.float32)
    columns = ["label", "x_px", "y_px", "radius_px"]
    for label, x, y, radius in contacts[columns].astype(float).to_numpy().tolist():
        reach = radius + 1.0
        top, left = (max(int(np.floor(place - reach)), 0) for place in (y, x))
        bottom, right = int(np.ceil(y + reach)) + 1, int(np.ceil(x + reach)) + 1
        window = (slice(top, max(bottom, 0)), slice(left, max(right, 0)))
        rows, cols = (np.arange(size)[part] for size, part in zip(shape, window, strict=True))
        if not (len(rows) and len(cols)):
            continue
        own = (cols - x) ** 2 + (rows[:, None] - y) ** 2 - radius**2
        mine = (own <= max(0.0, float(own.min()))) & (own < power[window])
        power[window][mine] = own[mine]
        labels[window][mine] = label
    return labels


def write_labels(contacts: pd.DataFrame, shape: tuple[int, ...], path: Path) -> None:
    """Write the label image of one frame as a TIFF, whole or not at all."""
    with replacing(path) as part:
        tifffile.imwrite(
            part, label_image(contacts, shape), compression="zlib", metadata=None, software=False
        )
