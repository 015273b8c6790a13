"""What the files of a folder probably are, for a first scene file."""

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.files.csv_tables import read_asperities, read_loads
from contactimg.files.experiment import is_correction
from contactimg.files.pixel_size import stated_pixel_size
from contactimg.files.sources import FrameSource, list_frames

_NO_CONTACT_STEM = re.compile(
    r"(reference|ref|background|bg|empty|blank|unloaded|(no|non|without)[ _-]?contact)s?"
    r"([ _-]?(frame|image))?([ _-]?\d+)?"
)
_TRIALS = 20  # CSV files that are tried as tables; chosen: a folder of results is not searched for long


@dataclass(frozen=True)
class FolderGuess:
    """What the names and headers of a folder's files say.

    Attributes
    ----------
    frames : tuple of str
        Names of the frames, without the reference and without dark frame, flat field and mask.
    references, darks, flats, masks : tuple of str
        Names of images that are called so.
    loads, asperities : str or None
        Name of the first table with the columns of one.
    load_N : tuple of float
        The loads in the table.
    pixel_size_m : float or None
        What the header of the first frame states (ImageJ or OME).
    """

    frames: tuple[str, ...]
    references: tuple[str, ...] = ()
    darks: tuple[str, ...] = ()
    flats: tuple[str, ...] = ()
    masks: tuple[str, ...] = ()
    loads: str | None = None
    asperities: str | None = None
    load_N: tuple[float, ...] = ()  # noqa: N815 the unit
    pixel_size_m: float | None = None


def guess_folder(folder: str | Path) -> FolderGuess:
    """Look at the names, tables and headers of a folder; no pixels are read.

    Parameters
    ----------
    folder : path-like

    Returns
    -------
    FolderGuess

    Raises
    ------
    InputError
        If the folder holds no image besides references.
    """
    folder = Path(folder)
    images = list_frames(folder)
    references = [one for one in images if _NO_CONTACT_STEM.fullmatch(one.path.stem.lower())]
    corrections = [one for one in images if is_correction(one.path)]
    frames = [one for one in images if one not in references and one not in corrections]
    frames = [one for one in frames if one.path.name.startswith("frame_")] or frames  # as `open_experiment`
    if not frames:
        raise InputError(f"{folder}: there is no frame besides {references[0].name}; add the frames")
    tables = sorted(folder.glob("*.csv"))[:_TRIALS]
    loads, load_table = _first_readable(tables, lambda path: read_loads(path, pulled=True))
    asperities, _ = _first_readable(tables, read_asperities)
    return FolderGuess(
        frames=tuple(one.name for one in frames),
        references=_files(references),
        darks=_files(one for one in corrections if one.path.stem.lower().startswith("dark")),
        flats=_files(one for one in corrections if one.path.stem.lower().startswith("flat")),
        masks=_files(one for one in corrections if one.path.stem.lower().startswith("mask")),
        loads=loads,
        asperities=asperities,
        load_N=() if load_table is None else tuple(load_table["load_N"].dropna()),
        pixel_size_m=stated_pixel_size(frames[0].path),
    )


def _files(sources: Iterable[FrameSource]) -> tuple[str, ...]:
    """Names of the files of the frames, each once."""
    return tuple(dict.fromkeys(one.path.name for one in sources))


def _first_readable(
    tables: list[Path], read: Callable[[Path], pd.DataFrame]
) -> tuple[str | None, pd.DataFrame | None]:
    """Name and content of the first table that can be read as one of its kind."""
    for path in tables:
        with suppress(InputError):
            return path.name, read(path)
    return None, None
