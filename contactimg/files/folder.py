"""What the files of a folder are, by name and content, where no scene says so."""

import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.errors import InputError
from contactimg.files.csv_tables import read_asperities, read_loads
from contactimg.files.sources import FrameSource, list_frames, natural_key

REFERENCE = re.compile(
    r"(reference|ref|background|bg|empty|blank|unloaded|(no|non|without)[ _-]?contact)s?"
    r"([ _-]?(frame|image))?([ _-]?\d+)?"
)
"""Name of an image, without its ending, that shows the sample without contact."""

CORRECTION = re.compile(r"(dark|flat|mask)([ _-]?(frame|field|image|s))?([ _-]?\d+)?")
"""Name of an image, without its ending, that corrects the pixels of others."""

TABLES = (".csv", ".lvm", ".txt", ".tsv", ".dat", ".asc")
"""Endings of files that may be tables of loads or asperities."""

TRIED_TABLES = 20
"""Files that are tried as tables. Chosen: a folder of results is not searched for long."""

OURS = {"scene.toml", "edits.csv"}
"""Files that other parts of the package find by their name."""


@dataclass(frozen=True)
class FolderFiles:
    """The files of a folder.

    Attributes
    ----------
    frames : list of FrameSource
    images : dict
        "reference", "dark", "flat" and "mask" -> names of files.
    loads, asperities : str
        Names of the tables; empty without one.
    columns : str
        Which columns of the loads were taken, in words.
    unloaded : bool
        Whether a frame has the load 0.
    ignored : list of str
        What is none of these.
    """

    frames: list[FrameSource]
    images: dict[str, list[str]]
    loads: str = ""
    asperities: str = ""
    columns: str = ""
    unloaded: bool = False
    ignored: list[str] = field(default_factory=list)

    @property
    def keys(self) -> dict[str, dict[str, Any]]:
        """Sections and keys of a scene that name the files."""
        reference, mask = self.images["reference"], self.images["mask"]
        images = {
            "reference": reference[0] if len(reference) == 1 else reference,
            "frames": [self.frames[0].name] if len(self.frames) == 1 else None,
            "loads": self.loads,
            "dark": _one_or_glob(self.images["dark"]),
            "flat": _one_or_glob(self.images["flat"]),
            "mask": mask[0] if len(mask) == 1 else None,
        }
        sections: dict[str, dict[str, Any]] = {"images": images, "asperities": {"file": self.asperities}}
        given = {
            name: {key: value for key, value in keys.items() if value} for name, keys in sections.items()
        }
        return {name: keys for name, keys in given.items() if keys}


def recognise_folder(folder: str | Path) -> FolderFiles:
    """Tell frames, reference, dark and flat frames, masks, loads and asperities of a folder; reads no pixels.

    Parameters
    ----------
    folder : str or Path

    Raises
    ------
    InputError
        If it holds no frame.
    """
    folder = Path(folder)
    listed = list_frames(folder)
    images = {
        kind: list(dict.fromkeys(one.path.name for one in listed if kind_of(one.path) == kind))
        for kind in ("reference", "dark", "flat", "mask")
    }
    frames = [one for one in listed if not kind_of(one.path)]
    if not frames:
        raise InputError(f"{folder}: there is no frame besides {listed[0].name}; add the frames")
    frames = [one for one in frames if one.path.name.startswith("frame_")] or frames  # as `open_experiment`
    asperities, loads = "", pd.DataFrame()
    files = sorted((path for path in folder.iterdir() if path.is_file()), key=natural_key)
    tables = [path for path in files if path.suffix.lower() in TABLES and path.name not in OURS]
    for path in sorted(tables, key=lambda path: path.name != "loads.csv")[:TRIED_TABLES]:
        with suppress(InputError):
            if not asperities:
                read_asperities(path)
                asperities = path.name
                continue
        with suppress(InputError):
            if loads.empty:
                loads = read_loads(path, pulled=True)
                loads.attrs["file"] = path.name
    file, columns = (str(loads.attrs.get(name, "")) for name in ("file", "columns"))
    unloaded = bool(file and (loads["load_N"] == 0).any())
    used = {one.path.name for one in frames}.union(*images.values()) | {file, asperities} | OURS
    ignored = [path.name for path in files if path.name not in used and not path.name.startswith(".")]
    return FolderFiles(frames, images, file, asperities, columns, unloaded, ignored)


def kind_of(path: Path) -> str:
    """What a file is called like: "reference", "dark", "flat", "mask", or "" for a frame.

    Examples
    --------
    >>> [kind_of(Path(name)) for name in ("run_1/Reference.TIF", "ref.tif", "refraction_2.tif")]
    ['reference', 'reference', '']
    >>> [kind_of(Path(name)) for name in ("dark.tif", "Flat_field2.png", "dark_contacts_01.tif")]
    ['dark', 'flat', '']
    """
    correction = CORRECTION.fullmatch(path.stem.lower())
    if correction:
        return correction[1]
    return "reference" if REFERENCE.fullmatch(path.stem.lower()) else ""


def _one_or_glob(names: list[str]) -> str | None:
    """The only name, a glob for several, or None; all begin with the word that they were recognised by."""
    return None if not names else names[0] if len(names) == 1 else f"{names[0][:4]}*{Path(names[0]).suffix}"
