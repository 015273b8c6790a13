"""Find and read frames of any format: lists of sources, and series that read each frame on demand."""

import glob
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import numpy as np

from contactimg.errors import FrameError, InputError
from contactimg.files import decoders
from contactimg.frame import Frame
from contactimg.optics.sensor import linearise
from contactimg.scene import Camera

PathLike = str | os.PathLike[str]

_Decoder = tuple[Callable[[Path], Sequence[int]], Callable[[Path, int], decoders.Pixels]]
"""Numbers of the images of a file, and the pixels of one of them."""

_DECODERS: dict[str, _Decoder] = {
    **dict.fromkeys((".tif", ".tiff"), (decoders.list_tiff, decoders.read_tiff)),
    **dict.fromkeys((".png", ".bmp", ".jpg", ".jpeg"), (lambda _: range(1), decoders.read_still)),
    ".seq": (decoders.list_norpix, decoders.read_norpix),
    **dict.fromkeys(
        (".avi", ".mp4", ".mov", ".mkv", ".wmv", ".mpg", ".mpeg"), (decoders.list_video, decoders.read_video)
    ),
}
SUFFIXES = tuple(_DECODERS)
"""File name extensions that hold frames; upper or lower case."""
MOST_OVER_FULL, HOT_SHARE = 1.05, 1e-3
"""Grey level of a saturated pixel over the stated full scale, and share of the pixels that may be above it.
Chosen: pixels of a sensor saturate a few per cent apart, and hot ones are fewer than one of a thousand."""
_ONE_IMAGE = re.compile(rf"(.+({'|'.join(map(re.escape, SUFFIXES))}))\[\d+\]", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FrameSource:
    """The file and page of one frame, without its pixels; cheap to list and to send to a worker process.

    Attributes
    ----------
    name : str
        File name with extension; ``name[k]``, k from 0, where the file holds several images.
    path : Path
        The file.
    index : int
        Number of the page or image in the file, from 0, including thumbnails.
    camera : Camera or None
        By whose response grey levels are made proportional to light; its full scale comes before that of the
        file.
    correct : callable or None
        Takes the frame as read and returns it corrected (`contactimg.files.corrections`).
    """

    name: str
    path: Path
    index: int = 0
    camera: Camera | None = None
    correct: Callable[[Frame], Frame] | None = None

    def read(self) -> Frame:
        """Read the frame.

        Returns
        -------
        Frame
            Grey levels; colour becomes ``0.299 R + 0.587 G + 0.114 B`` unrounded, transparency is dropped,
            black-and-white becomes 0 and 255. Full scale: the camera's, else what the file says of the sensor
            (TIFF MaxSampleValue of the form 2^n - 1, bit depth of a Norpix sequence), else that of the dtype.
            With a response of the camera: float32, proportional to light. Then corrected, if so asked.

        Raises
        ------
        FrameError
            If the file cannot be read, or has grey levels above the full scale of the camera: one sentence
            with the file and the reason.
        """
        try:
            with warnings.catch_warnings(action="ignore"):
                pixels = _decoder(_checked(self.path))[1](self.path, self.index)
                image = decoders.to_grey(pixels.array)
        except Exception as error:
            raise FrameError(f"{self.name} cannot be read: {_reason(error)}") from None
        stated = None if self.camera is None else self.camera.full_scale
        if stated is not None and np.count_nonzero(image > MOST_OVER_FULL * stated) > HOT_SHARE * image.size:
            raise FrameError(
                f"{self.name} has grey levels up to {image.max():g}, and [camera] full_scale_levels = "
                f"{stated:g}: give the level at which the sensor saturates, or leave the key out"
            )
        frame = Frame(image, self.name, pixels.full_scale if stated is None else stated)
        frame = linearise(frame, self.camera)
        return frame if self.correct is None else self.correct(frame)


def _decoder(path: Path) -> _Decoder:
    """The function that lists the images of files with this extension."""
    if path.suffix.lower() not in _DECODERS:
        raise InputError(
            f"{path}: frames have one of the extensions {', '.join(SUFFIXES)}, got {path.suffix or 'none'!r}"
        )
    return _DECODERS[path.suffix.lower()]


def _checked(path: Path) -> Path:
    """The path; raise if it is a folder or an empty file."""
    if path.is_dir():
        raise ValueError("it is a folder, not a file")
    if path.stat().st_size == 0:
        raise ValueError("the file is empty (0 bytes)")
    return path


def _reason(error: Exception) -> str:
    """The first line of an error message, or the type of the error if the message is empty."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return "the file is damaged, or the image does not fit into memory"
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


def natural_key(text: PathLike) -> str:
    """Sort key that places ``frame_2`` before ``frame_10``; for 10^5 names in little memory.

    Examples
    --------
    >>> sorted(["frame_10.tif", "frame_2.tif"], key=natural_key)
    ['frame_2.tif', 'frame_10.tif']
    """
    text = os.fspath(text)
    # a number by its length and its digits, the name itself last; NUL is in no name and sorts before all else
    parts = re.split(r"([0-9]+)", text.casefold())
    digits = (part.lstrip("0") for part in parts[1::2])
    parts[1::2] = [f"\0{chr(len(number) + 1)}{number}" for number in digits]
    return "".join(parts) + "\0\0" + text


def list_frames(path: PathLike | Iterable[PathLike], *, folder: PathLike = ".") -> list[FrameSource]:
    """List the frames of a folder, a glob, a file, one of its images, or a list of these; reads no image.

    Parameters
    ----------
    path : path-like or iterable of path-like
        A folder gives its image files (without hidden files and sub-folders), a glob the image files that
        match; both in natural order. A list keeps its order. A file with several images gives all of them, or
        one by its name ``name[k]``.
    folder : path-like
        Folder that relative paths refer to.

    Returns
    -------
    list of FrameSource
        A file that cannot be read is listed as well; reading it raises an error.

    Raises
    ------
    InputError
        If nothing is found, an extension is not that of an image, or two frames have the same name.

    Examples
    --------
    >>> list_frames("no_such_folder/*.tif")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    contactimg.errors.InputError: no_such_folder/*.tif matches no image file; looked for .tif, ...
    """
    entries = [path] if isinstance(path, str | os.PathLike) else list(path)
    if not entries:
        raise InputError("the list of frames is empty; name at least one file, folder or glob")
    sources = [source for entry in entries for source in _sources(Path(folder), os.fspath(entry))]
    names = Counter(source.name for source in sources)
    if len(names) < len(sources):
        name, count = names.most_common(1)[0]
        paths = [str(source.path) for source in sources if source.name == name]
        cure = "name it once" if paths[0] == paths[1] else "rename one of them"
        raise InputError(f"{count} frames are called {name} ({paths[0]} and {paths[1]}); {cure}")
    return sources


def named_file(name: str, folder: Path) -> str:
    """The name of a file: of the one that holds ``name[k]``, any other as it is; it need not exist.

    Examples
    --------
    >>> named_file("stack.tif[3]", Path("no_such_folder"))
    'stack.tif'
    """
    image = _ONE_IMAGE.fullmatch(name)
    return image[1] if image and not (folder / name).exists() else name


def _sources(folder: Path, entry: str) -> list[FrameSource]:
    """The images of one path, glob or ``name[k]``; raise if there is none."""
    file = named_file(entry, folder)
    sources = [source for path in _files(folder, file) for source in _images(path)]
    chosen = [source for source in sources if file == entry or source.name == Path(entry).name]
    if not chosen:
        some = f"{sources[0].name} ... {sources[-1].name}"
        raise InputError(f"{folder / entry}: there is no such image; name one of {some}")
    return chosen


def _files(folder: Path, entry: str) -> Iterable[Path]:
    """The image files of one path or glob; raise if there is none."""
    path = folder / entry
    if path.is_dir():
        found = list(path.iterdir())
    elif path.exists():
        _decoder(path)
        return [path]
    elif glob.has_magic(entry):
        matches = glob.glob(entry, root_dir=folder, recursive=True)  # noqa: PTH207 (may be absolute)
        found = [folder / match for match in matches]
    else:
        raise InputError(f"{path}: there is no such file or folder")
    files = sorted(filter(is_image, found), key=lambda file: natural_key(file.as_posix()))
    if not files:
        complaint = f"{path} {'holds' if path.is_dir() else 'matches'} no image file"
        raise InputError(f"{complaint}; looked for {', '.join(SUFFIXES)}")
    return files


def is_image(path: Path) -> bool:
    """True for a file, not hidden, with the extension of an image; also for a link to one that is gone."""
    named = path.suffix.lower() in _DECODERS and not path.name.startswith(".")
    return named and (path.is_file() or not path.exists())


def _images(path: Path) -> list[FrameSource]:
    """The images of one file; a file that cannot be opened is listed once and fails when it is read."""
    try:
        with warnings.catch_warnings(action="ignore"):
            numbers = _decoder(path)[0](_checked(path))
    except Exception:  # reported when the image is read
        numbers = range(1)
    if len(numbers) <= 1:
        return [FrameSource(path.name, path, index) for index in numbers or range(1)]
    return [FrameSource(f"{path.name}[{k}]", path, index) for k, index in enumerate(numbers)]


class FrameSeries(Sequence[Frame]):
    """Frames in order; each is read on demand and not kept.

    Parameters
    ----------
    sources : iterable of FrameSource
        The sources of the frames.
    """

    def __init__(self, sources: Iterable[FrameSource]) -> None:
        self.sources = tuple(sources)

    @property
    def names(self) -> list[str]:
        """Names of the frames."""
        return [source.name for source in self.sources]

    def __len__(self) -> int:
        return len(self.sources)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> "FrameSeries": ...

    def __getitem__(self, index: int | slice) -> "Frame | FrameSeries":
        """Read one frame, or take a part of the series without reading."""
        return FrameSeries(self.sources[index]) if isinstance(index, slice) else self.sources[index].read()


def read_frames(path: PathLike | Iterable[PathLike]) -> FrameSeries:
    """The frames of a folder, a glob, a file or a list of these, as a sequence that reads each on demand.

    Parameters
    ----------
    path : path-like or iterable of path-like
        TIFF (any bit depth, byte order, compression, several pages), PNG, BMP, JPEG, Norpix ``.seq``
        (uncompressed monochrome), AVI and other videos; see `list_frames`.

    Returns
    -------
    FrameSeries
        With ``len``, ``names``, indexing and iteration; holds one frame in memory. A bad file raises
        `FrameError` when its frame is read.

    Raises
    ------
    InputError
        If nothing is found, an extension is not that of an image, or two frames have the same name.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> from contactimg import Frame
    >>> from contactimg.files import write_frame
    >>> with TemporaryDirectory() as folder:
    ...     for k in (10, 2):
    ...         write_frame(Frame(np.full((3, 4), k, np.uint8)), Path(folder) / f"frame_{k}.tif")
    ...     frames = read_frames(folder)
    ...     frames.names, [int(frame.image[0, 0]) for frame in frames]
    (['frame_2.tif', 'frame_10.tif'], [2, 10])
    """
    return FrameSeries(list_frames(path))
