"""Read AVI and other videos with OpenCV."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from contactimg.files.grey import Pixels
from contactimg.files.limits import check_size

_lock = threading.Lock()  # stderr belongs to the whole process


def list_images(path: Path) -> range:
    """Numbers of the images; they are counted if the container does not state their number."""
    with _opened(path) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if count > 0:
            return range(min(count, path.stat().st_size))  # an image takes a byte or more
        count = 0
        while video.grab():
            count += 1
        return range(count)


def read_image(path: Path, index: int) -> Pixels:
    """Image number ``index``, from 0, in red, green and blue."""
    with _opened(path) as video:
        check_size(int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        if index:
            video.set(cv2.CAP_PROP_POS_FRAMES, index)
        read, image = video.read()
    if not read:
        raise ValueError("the video is truncated or damaged at this image")
    if image.ndim == 3:
        image = image[..., ::-1]
    return Pixels(image, 255.0)


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    """The open video."""
    with _quiet():
        video = cv2.VideoCapture(str(path))
        try:
            if not video.isOpened():
                raise ValueError("the content is not that of a video that OpenCV can decode")
            yield video
        finally:
            video.release()


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress stderr, to which OpenCV and FFmpeg write directly."""
    with _lock, Path(os.devnull).open("wb") as nowhere:
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
