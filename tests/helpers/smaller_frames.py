"""Frames of the sample data with fewer pixels, for tests of what runs on them and not of what it finds."""

from pathlib import Path

import cv2

from contactimg.files import read_frames, read_scene, write_frame, write_scene
from contactimg.frame import Frame


def widen_pixels(folder: Path) -> None:
    """Join four pixels of each TIFF file inside a folder to one; scenes beside them say so."""
    for path in folder.rglob("*.tif"):
        frame = read_frames(path)[0]
        joined = cv2.resize(frame.image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        write_frame(Frame(joined, frame.name, frame.full_scale), path)
    for path in folder.rglob("scene.toml"):
        source = read_scene(path).source
        source["camera"]["pixel_size_m"] *= 2.0
        write_scene(source, path)


def crop(folder: Path) -> None:
    """Keep the middle of each TIFF file inside a folder, half as wide and high."""
    for path in folder.rglob("*.tif"):
        frame = read_frames(path)[0]
        rows, columns = (slice(size // 4, size - size // 4) for size in frame.image.shape)
        write_frame(Frame(frame.image[rows, columns].copy(), frame.name, frame.full_scale), path)
