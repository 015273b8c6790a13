"""A scene file and the files it names, or what the files of a folder are where no scene says so."""

import logging
import math
import re
import tomllib
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pandas as pd
import tomlkit

from contactimg.errors import InputError
from contactimg.files.atomic import first_names, flush_to_disk, naming, read_bytes, write_text
from contactimg.files.corrections import EDITS_FILE, PixelCorrections, find_areas, masked_areas, read_edits
from contactimg.files.decoders import stated_pixel_size
from contactimg.files.output import finish_commit
from contactimg.files.sources import FrameSource, is_image, list_frames, named_file, natural_key
from contactimg.files.tables import in_western_code, read_asperities, read_loads
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import EDITS, LOADS

logger = logging.getLogger(__name__)

SCENE_FILE = "scene.toml"
"""Name of the scene file in a folder."""

_TABLES = {
    "loads": ("images", "loads", "loads.csv"),
    "edits": ("images", "edits", EDITS_FILE),
    "asperities": ("asperities", "file", None),
}
"""Table -> section and key that name it, and its usual name in the folder of the scene."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """The files of one experiment, found and checked; no frame has been read yet.

    Attributes
    ----------
    scene : Scene
        The description of the experiment.
    references : tuple of FrameSource
        The non-contact frames, usually one; empty if the scene names none.
    frames : sequence of FrameSource
        The frames in order, without the reference.
    loads : DataFrame
        Columns of `contactimg.tables.LOADS`, one row per frame in the same order; NaN without a load.
    asperities : DataFrame or None
        Columns of `contactimg.tables.ASPERITIES`; None if the scene names no table.
    others : tuple of Path
        The files that every frame's result depends on: references, tables, dark frame, flat field and masks.
    edits : DataFrame
        Corrections by hand, columns of `contactimg.tables.EDITS`; those that mask act on the pixels.
    """

    scene: Scene
    references: tuple[FrameSource, ...]
    frames: Sequence[FrameSource]
    loads: pd.DataFrame
    asperities: pd.DataFrame | None
    others: tuple[Path, ...]
    edits: pd.DataFrame = field(default_factory=EDITS.empty)

    @property
    def inputs(self) -> list[Path]:
        """Every file that a result depends on, once: references, frames, the others."""
        images = [source.path for source in (*self.references, *self.frames)]
        return list(dict.fromkeys([*images, *self.others]))

    def load_of(self, name: str) -> float:
        """Load P (N) of the frame with this name, NaN without one."""
        return self._loads.get(name, math.nan)

    @cached_property
    def _loads(self) -> dict[str, float]:
        """Frame -> load, N."""
        return dict(zip(self.loads["frame"], self.loads["load_N"].tolist(), strict=True))


def read_scene(path: str | Path) -> Scene:
    r"""Read a scene file.

    Parameters
    ----------
    path : str or Path
        A TOML file, or a folder that holds a ``scene.toml``.

    Returns
    -------
    Scene
        Validated; its `Scene.folder` is what its relative paths are relative to.

    Raises
    ------
    InputError
        If there is no such file, it is not TOML (with line and column), or a key breaks a rule.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "scene.toml").write_text("[camera]\npixel_size_m = 6.0e-6\n")
    ...     read_scene(folder).camera.pixel_size
    6e-06
    """
    path = Path(path)
    file = path / SCENE_FILE if path.is_dir() else path
    finish_commit(file.parent)
    if not file.exists():
        raise InputError(f"{file}: there is no such scene file; write one, or give its path")
    return scene_from_dict(tomllib.loads(_toml(file)), name=str(file), folder=str(file.parent))


def _toml(file: Path) -> str:
    """The text of a file, if it is TOML."""
    try:
        text = read_bytes(file).decode("utf-8-sig")
        tomllib.loads(text)
    except UnicodeDecodeError:
        raise InputError(f"{file}: is not UTF-8 text; save it in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        number = re.search(r"at line (\d+)", str(error))
        shown = f": {text.splitlines()[int(number[1]) - 1].strip()[:60]}" if number else ""
        raise InputError(f"{file}: is not valid TOML: {error}{shown}") from None
    return text


def write_scene(data: Mapping[str, object], path: str | Path) -> None:
    """Write a scene file, whole or not at all.

    Parameters
    ----------
    data : mapping
        Sections and keys as in the file (`Scene.source` or `Scene.configuration`), valid.
    path : str or Path
        The TOML file.
    """
    scene_from_dict(data, name=str(path))
    write_text(tomlkit.dumps(data), path)


def open_experiment(scene: Scene, *, pulled: bool = False) -> Experiment:
    """Find and check the files that a scene names.

    Parameters
    ----------
    scene : Scene
        From `read_scene`, or from a dict with the folder given.
    pulled : bool
        Whether negative loads are allowed; see `read_loads`.

    Returns
    -------
    Experiment
        A frame without a load, and a load without a frame, are logged as warnings.

    Raises
    ------
    InputError
        If a named file is missing or not valid, there is no frame, or no load belongs to a frame.
    """
    images, folder = scene.images, Path(scene.folder)
    references, dark, flat = (_named_images(scene, kind) for kind in ("reference", "dark", "flat"))
    masks = [folder / mask for mask in images.masks.values() if isinstance(mask, str)]
    used = [*(source.path for source in (*dark, *flat)), *masks]
    frames = _find_frames(scene, references, set(used))
    tables = {name: path for name in _TABLES if (path := _table(scene, name)) is not None}
    edits = read_edits(tables["edits"]) if "edits" in tables else EDITS.empty()
    names = [frame.name for frame in frames]
    loads = _align_loads(tables.get("loads"), names, pulled=pulled)
    areas = find_areas(images.masks, folder, names) + masked_areas(edits)
    corrections = PixelCorrections(dark, flat, areas, masked=bool(areas))
    if corrections:
        numbered = enumerate(frames, start=1)
        frames = [replace(one, correct=corrections.of_frame(one.name, k)) for k, one in numbered]
        references = tuple(replace(one, correct=corrections.of_frame("", 0)) for one in references)
    _compare_pixel_size(scene, frames[0].path)
    others = dict.fromkeys([*(source.path for source in references), *tables.values(), *used])
    return Experiment(scene, references, frames, loads, read_scene_asperities(scene), tuple(others), edits)


def _compare_pixel_size(scene: Scene, path: Path) -> None:
    """Log where the scene states no pixel size, or the header of a frame another one or none of a square."""
    sides, pixel = stated_pixel_size(path), scene.camera.pixel_size if scene.camera else None
    header, height = sides or (0.0, 0.0)
    says = f"{path.name} states pixels of {1e6 * header:.4g} µm" if header else ""
    if not math.isclose(header, height, rel_tol=1e-3):  # of numbers with four digits
        cure = "they are taken as square; resample the frames, or correct the header"
        logger.warning("%s: %s by %.4g µm: %s", scene.folder, says, 1e6 * height, cure)
    if pixel is None:
        cure = "state [camera] pixel_size_m"
        said = "no pixel size is stated, so there are no areas in m2 and no forces"
        logger.warning("%s: %s; %s%s", scene.folder, said, cure, f" ({says})" if says else "")
    # chosen: above errors of a calibration, below the steps of objectives and binning
    elif header and not math.isclose(header, pixel, rel_tol=0.1):
        cure = "areas are those of the scene; correct the one that is wrong"
        logger.warning("%s: %s, the scene pixels of %.4g µm: %s", scene.folder, says, 1e6 * pixel, cure)


def read_scene_asperities(scene: Scene) -> pd.DataFrame | None:
    """The asperity table that a scene names, None if it names none; see `read_asperities`."""
    path = _table(scene, "asperities")
    return None if path is None else read_asperities(path)


def read_scene_loads(scene: Scene) -> list[float]:
    """The loads (N) in the table of a scene or in loads.csv beside it, if there is one; see `read_loads`."""
    path = _table(scene, "loads")
    return [] if path is None else read_loads(path, pulled=True)["load_N"].dropna().tolist()


def _table(scene: Scene, name: str) -> Path | None:
    """Path of a table that the scene names, or of that of the usual name where it is there."""
    section, key, usual = _TABLES[name]
    named = getattr(getattr(scene, section), key, None)
    path = Path(scene.folder) / (named or usual or "")
    return path if named or path.is_file() else None


def _named_images(scene: Scene, kind: str) -> tuple[FrameSource, ...]:
    """The images that a key names."""
    named, found = getattr(scene.images, kind), list[FrameSource]()
    for entry in [named] if isinstance(named, str) else named or []:
        with naming(f"[images] {kind}"):
            found += list_frames(entry, folder=scene.folder)
    return tuple(replace(one, camera=scene.camera) for one in dict.fromkeys(found))


def _find_frames(scene: Scene, references: Sequence[FrameSource], used: set[Path]) -> list[FrameSource]:
    """The frames of a scene, without the references and the files that are used otherwise."""
    folder, named = Path(scene.folder), scene.images.frames
    if named is None:
        named = "frame_*" if any(is_image(path) for path in folder.glob("frame_*")) else "."
    places = {(reference.path.resolve(), reference.index) for reference in references}
    chosen = {folder / named_file(name, folder) for name in ([named] if isinstance(named, str) else named)}
    by_kind = defaultdict[str, list[FrameSource]](list)
    for one in list_frames(named, folder=folder):
        if one.path not in used and (one.path.resolve(), one.index) not in places:
            by_kind["" if one.path in chosen else kind_of(one.path)].append(one)
    frames = [replace(one, camera=scene.camera) for one in by_kind.pop("", [])]
    if not frames:
        besides = first_names(one.name for one in references or by_kind["reference"])
        raise InputError(f"{scene.folder}: there is no frame besides the reference {besides}")
    for kind, others in sorted(by_kind.items()):
        names, cure = first_names(one.name for one in others), f"name it as the {kind}, or list it in"
        logger.warning("%s: %s is not measured as a frame; %s [images] frames", folder, names, cure)
    return frames


def edits_file(scene: Scene) -> Path:
    """The table of corrections that a scene names, or edits.csv beside it."""
    return Path(scene.folder) / (scene.images.edits or EDITS_FILE)


def _align_loads(path: Path | None, names: list[str], *, pulled: bool) -> pd.DataFrame:
    """One row per frame, which the table may name with a path, without extension or by number.

    Names that differ only in capitals or in how accents are encoded are the same where one frame has them.
    Mismatches are logged.

    Raises
    ------
    InputError
        If two rows mean the same frame, one may mean several, or no load belongs to a frame.
    """
    if path is None:
        return LOADS.conform({"frame": names})
    loads, present = read_loads(path, pulled=pulled), set(names)
    if "remark" in loads.attrs:
        logger.warning("%s: %s", path, loads.attrs["remark"])
    alike: dict[str, set[str]] = {}
    for name in names:
        for alias in (name, Path(name).stem):
            alike.setdefault(_plain(alias), set()).add(name)
    for number, name in _by_number(path, loads["frame"].tolist(), names).items():
        alike.setdefault(number, {name})

    def meant(given: str) -> str:
        last = re.split(r"[/\\]", given)[-1]
        exact, frames = {given, last} & present, alike.get(_plain(last), set())
        if not exact and len(frames) > 1:
            several = first_names(sorted(frames))
            raise InputError(f"{path}: {last} means several frames ({several}): give the whole name")
        return next(iter(exact or frames or {given}))

    loads["frame"] = loads["frame"].map(meant)
    repeated = loads["frame"][loads["frame"].duplicated()]
    if len(repeated):
        raise InputError(f"{path}: {len(repeated) + 1} rows mean the frame {repeated.iloc[0]}; keep one")
    known = set(loads["frame"][loads["load_N"].notna()])
    if not known & present:
        given = first_names(loads["frame"]) or "it has no row"
        raise InputError(f"{path}: none of its frames ({given}) is among those read ({first_names(names)})")
    for text, missing in (
        ("has loads for frames that are not there", [name for name in loads["frame"] if name not in present]),
        ("has no load for the frames", [name for name in names if name not in known]),
    ):
        if missing:
            logger.warning("%s %s: %s", path, text, first_names(missing))
    return LOADS.conform(loads.set_index("frame").reindex(names).reset_index())


def _plain(name: str) -> str:
    """The name in small letters, each accent in one character with its letter."""
    return unicodedata.normalize("NFC", in_western_code(name)).casefold()


def _by_number(path: Path, given: list[str], names: list[str]) -> dict[str, str]:
    """Number as it is given -> frame: its row ``#k``, its place in a movie, or the last number in its name.

    Images of a movie are counted from 0, or from 1 where the largest number is theirs.
    """
    if any(re.fullmatch(r"#\d+", text) for text in given):
        if len(given) != len(names):
            raise InputError(
                f"{path}: has {len(given)} rows that name no frame, and there are {len(names)} frames; add a "
                "column frame, or one row a frame"
            )
        return dict(zip(given, names, strict=True))
    whole = (text for text in given if re.fullmatch(r"\d+([.,]0*)?", text))
    numbers = {text: int(float(text.replace(",", "."))) for text in whole}
    if all(name.endswith("]") for name in names):
        first = int(max(numbers.values(), default=0) == len(names) and 0 not in numbers.values())
        frames = dict(enumerate(names, start=first))
    else:
        last = [(int(found[-1]), name) for name in names if (found := re.findall(r"\d+", Path(name).stem))]
        counts = Counter(k for k, _ in last)
        frames = {k: name for k, name in last if counts[k] == 1}
    return {text: frames[k] for text, k in numbers.items() if k in frames}


def set_scene_keys(path: str | Path, section: str, keys: Mapping[str, str | float]) -> None:
    r"""Set keys of one section of a scene file; comments, order and all other keys stay.

    Parameters
    ----------
    path : str or Path
        The TOML file; it must exist.
    section : str
        Added at the end if the file has none of this name.
    keys : mapping
        Key -> value.

    Raises
    ------
    InputError
        If the file cannot be read or written, or the scene would not be valid.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "scene.toml"
    ...     _ = path.write_text("[measure]  # how\nthreshold = 0.5 # half\n")
    ...     set_scene_keys(path, "measure", {"threshold": 0.4})
    ...     path.read_text()
    '[measure]  # how\nthreshold = 0.4 # half\n'
    """
    path = Path(path)
    document = tomlkit.parse(_toml(path))
    if section not in document:
        document.add(tomlkit.nl())
        document.add(section, tomlkit.table())
    document[section].update(keys)
    scene_from_dict(document.unwrap(), name=str(path), folder=str(path.parent))
    write_text(document.as_string(), path)
    flush_to_disk(path)


# --- what the files of a folder are, by name and content

OURS = {SCENE_FILE, EDITS_FILE}
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
        images = {kind: names[0] if len(names) == 1 else names for kind, names in self.images.items()}
        frames = [self.frames[0].name] if len(self.frames) == 1 else []
        images |= {"frames": frames, "loads": self.loads}
        if len(self.images["mask"]) > 1:  # which of them belongs to which frame, no name tells
            del images["mask"]
        sections = {"images": {key: value for key, value in images.items() if value}}
        return sections | ({"asperities": {"file": self.asperities}} if self.asperities else {})


def recognise_folder(folder: str | Path, *, frames_named: bool = False) -> FolderFiles:
    """Tell frames, reference, dark and flat frames, masks, loads and asperities of a folder; reads no pixels.

    Parameters
    ----------
    folder : str or Path
    frames_named : bool
        Whether it is stated which images are frames; these may be in other folders.

    Raises
    ------
    InputError
        If it holds no frame, unless they are named.
    """
    folder = Path(folder)
    listed = [] if frames_named and not any(map(is_image, folder.iterdir())) else list_frames(folder)
    images = {
        kind: list(dict.fromkeys(one.path.name for one in listed if kind_of(one.path) == kind))
        for kind in ("reference", "dark", "flat", "mask")
    }
    frames = [one for one in listed if not kind_of(one.path)]
    if not frames and not frames_named:
        raise InputError(f"{folder}: there is no frame besides {listed[0].name}; add the frames")
    frames = [one for one in frames if one.path.name.startswith("frame_")] or frames  # as `open_experiment`
    files = sorted((path for path in folder.iterdir() if path.is_file()), key=natural_key)
    endings = (".csv", ".lvm", ".txt", ".tsv", ".dat", ".asc")
    tables = [path for path in files if path.suffix.lower() in endings and path.name not in OURS]
    # so few files are tried, chosen: a folder of results is not searched for long
    tables = sorted(tables, key=lambda path: path.name != "loads.csv")[:20]
    asperities, _ = _first_table(tables, read_asperities)
    others = [path for path in tables if path.name != asperities]
    file, loads = _first_table(others, partial(read_loads, pulled=True))
    columns, unloaded = str(loads.attrs.get("columns", "")), bool((loads["load_N"] == 0).any())
    used = {one.path.name for one in frames}.union(*images.values()) | {file, asperities} | OURS
    ignored = [path.name for path in files if path.name not in used and not path.name.startswith(".")]
    return FolderFiles(frames, images, file, asperities, columns, unloaded, ignored)


def _first_table(files: list[Path], read: Callable[[Path], pd.DataFrame]) -> tuple[str, pd.DataFrame]:
    """Name and rows of the first file that is such a table; without any, no name and no load."""
    for path in files:
        with suppress(InputError):
            return path.name, read(path)
    return "", LOADS.empty()


def kind_of(path: Path) -> str:
    """The kind that the name of a file suggests: "reference", "dark", "flat", "mask", or "" for a frame.

    Examples
    --------
    >>> [kind_of(Path(name)) for name in ("run_1/Reference.TIF", "ref.tif", "refraction_2.tif")]
    ['reference', 'reference', '']
    >>> [kind_of(Path(name)) for name in ("dark.tif", "Flat_field2.png", "dark_contacts_01.tif")]
    ['dark', 'flat', '']
    """
    name = path.stem.lower()
    if correction := re.fullmatch(r"(dark|flat|mask)([ _-]?(frame|field|image|s))?([ _-]?\d+)?", name):
        return correction[1]
    without = r"(reference|ref|background|bg|empty|blank|unloaded|(no|non|without)[ _-]?contact)s?"
    return "reference" if re.fullmatch(without + r"([ _-]?(frame|image))?([ _-]?\d+)?", name) else ""
