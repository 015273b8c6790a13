"""The scene of a command: the scene file, what a calibration found, and what the options state."""

from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from types import MappingProxyType
from typing import Any

from contactimg import files
from contactimg.cli.options import Stated
from contactimg.cli.printing import say
from contactimg.errors import InputError
from contactimg.scene import Scene, scene_from_dict

FILES = {"images": {"reference", "loads", "dark", "flat", "mask", "edits"}, "asperities": {"file"}}
"""Section -> the keys that name files."""


def scene_of_folder(
    folder: str | Path,
    stated: Stated,
    *,
    scene_file: str | None = None,
    calibration: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[Scene, list[Path]]:
    """The scene of a folder of frames, and the scene file if there is one.

    Parameters
    ----------
    folder : path-like
        With a ``scene.toml``, or with frames only.
    stated : Stated
        Keys that replace those of the scene; files are relative to the working directory or the folder.
    scene_file : path-like or None
        Instead of the scene file in the folder; files that are missing in the folder are those beside it.
    calibration : mapping
        From `contactimg calibrate`; its results replace keys of the scene file.

    Raises
    ------
    InputError
        If the scene file or an option breaks a rule.
    """
    folder = Path(folder)
    if folder.is_file():
        raise InputError(f"{folder} is a file; give the folder that holds the frames")
    file = Path(scene_file or folder / files.SCENE_FILE)
    inputs = [file] if scene_file or file.exists() else []
    if inputs:
        read = files.read_scene(file)
        data = _placed(deepcopy(read.source), folder, first=folder, other=Path(read.folder))
    else:
        found = files.recognise_folder(folder, frames_named="frames" in stated.get("images", {}))
        data = found.keys
        if found.ignored:
            say(f"{folder}: not used: {', '.join(found.ignored)}")
    apply_calibration(data, calibration, sets_method="method" not in stated.get("measure", {}))
    given = _placed(deepcopy(stated), folder, first=Path(), other=folder)
    return _plausible(data, given, folder), inputs


def scene_at(path: str | Path, stated: Stated) -> tuple[Scene, list[Path]]:
    """The scene of a model, with the keys that options state, and the files that a prediction depends on.

    ``path`` is a scene file, or the folder that holds one.
    """
    read, path = files.read_scene(path), Path(path)
    scene = _plausible(deepcopy(read.source), stated, read.folder)
    inputs = [path / files.SCENE_FILE if path.is_dir() else path]
    if scene.asperities is not None and scene.asperities.file is not None:
        inputs.append(Path(scene.folder) / scene.asperities.file)
    return scene, inputs


def plausible(scene: Scene) -> Scene:
    """The scene, unless physics makes one of its values doubtful.

    Raises
    ------
    InputError
        For a value that is probably a slip (`contactimg.plausibility`), without ``--no-plausibility``.
    """
    from contactimg.plausibility import doubts_about_scene, settle

    asperities, loads = None, list[float]()
    with suppress(InputError):  # a file that cannot be read: the command itself says so
        asperities = files.read_scene_asperities(scene)
        loads = files.read_scene_loads(scene)
    settle(doubts_about_scene(scene, asperities, loads), str(Path(scene.folder)))
    return scene


def _plausible(data: Stated, stated: Stated, folder: str | Path) -> Scene:
    for section, keys in stated.items():
        if keys:
            data[section] = data.get(section, {}) | keys
    return plausible(scene_from_dict(data, name="the options and the scene", folder=str(folder)))


def _placed(data: Stated, folder: Path, *, first: Path, other: Path) -> Stated:
    """The sections with the files that they name: found from one folder, else those of another one.

    A name stays as it is in the one of the two that is ``folder``, to which the scene will belong.
    """

    def placed(named: Any) -> Any:
        """A name, or those in a list or a table of masks; numbers of a polygon stay."""
        if isinstance(named, list):
            return [placed(one) for one in named]
        if isinstance(named, dict):
            return {frame: placed(one) for frame, one in named.items()}
        if not isinstance(named, str):
            return named
        found = (first / files.named_file(named, first)).exists()
        found = found or (not Path(named).is_absolute() and any(first.glob(named)))  # a glob
        base = first if found else other
        return named if base == folder else str((base / named).resolve())

    for section, keys in data.items():
        for key in keys.keys() & FILES.get(section, set()):
            keys[key] = placed(keys[key])
    return data


# --- what a calibration acts on


KEYS = {
    "young_modulus": ("elastic", "young_modulus_Pa", "young_modulus_std_Pa"),
    "threshold": ("measure", "threshold", "threshold_std"),
    "edge_shift": ("measure", "edge_shift_px", "edge_shift_std_px"),
}
"""Result of a calibration -> section, and key of its value and of its standard uncertainty."""

ACTS_ON = {"threshold": "threshold", "edge_shift": "disk"}
"""Result of a calibration -> the only method that it acts on."""


def results_of(record: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Name -> value and standard uncertainty of what a calibration found.

    A threshold holds at the modulus that it was found with, which is among them.
    """
    entries = {"young_modulus": record.get("fixed", {}).get("young_modulus"), **record}
    found = {name: entry for name in KEYS if (entry := entries.get(name))}
    return {name: (entry["value"], float(entry.get("std") or 0.0)) for name, entry in found.items()}


def apply_calibration(data: Stated, record: Mapping[str, Any], *, sets_method: bool) -> None:
    """Write the results of a calibration, and the method they are for, into the sections of a scene.

    Parameters
    ----------
    data : dict
        Sections of the scene; changed.
    record : mapping
        Contents of ``calibration.json``.
    sets_method : bool
        Whether a threshold chooses its method, unless the scene does.

    Examples
    --------
    >>> data = {"elastic": {"young_modulus_Pa": 3e6}}
    >>> apply_calibration(data, {"young_modulus": {"value": 2.9e6, "std": 1e4}}, sets_method=True)
    >>> data["elastic"]
    {'young_modulus_Pa': 2900000.0, 'young_modulus_std_Pa': 10000.0}
    """
    for name, numbers in results_of(record).items():
        section, *keys = KEYS[name]
        data.setdefault(section, {}).update(zip(keys, numbers, strict=True))
    if "threshold" in record:
        correlation = record.get("correlation", {}).get("threshold, young_modulus") or 0.0
        data["measure"]["threshold_modulus_correlation"] = correlation
        if sets_method:
            data["measure"].setdefault("method", "threshold")


def refuse_idle(record: Mapping[str, Any], path: str, *, method: str) -> None:
    """Refuse a threshold, calibrated or given, where disks are fitted: it would change nothing.

    Raises
    ------
    InputError
        If it can act on nothing.
    """
    if record.get("kind") in ("threshold", "plateau") and method == "disk":
        raise InputError(
            f'{path}: a threshold acts on the method "threshold" only, and the method here is "disk"; take '
            "--method threshold, or a calibration of the modulus"
        )


def describe_use(record: Mapping[str, Any], *, method: str) -> str:
    """One sentence on which result of a calibration acts on which numbers of a run.

    Examples
    --------
    >>> record = {"threshold": {"value": 0.45, "std": 0.01}, "fixed": {"young_modulus": {"value": 3e6}}}
    >>> describe_use(record, method="threshold")
    'modulus 3 +- 0 MPa on the forces; threshold 0.45 +- 0.01 on all radii'
    >>> describe_use(record, method="disk")
    'modulus 3 +- 0 MPa on the forces; threshold 0.45 +- 0.01 on nothing: the method is disk'
    """
    parts = []
    for name, (value, std) in results_of(record).items():
        factor, unit = {"young_modulus": (1e-6, " MPa"), "edge_shift": (1.0, " px")}.get(name, (1.0, ""))
        acts_on = "the forces" if name == "young_modulus" else "all radii"
        if name in ACTS_ON and ACTS_ON[name] != method:
            acts_on = f"nothing: the method is {method}"
        said = name.removeprefix("young_").replace("_", " ")
        parts.append(f"{said} {value * factor:.4g} +- {std * factor:.2g}{unit} on {acts_on}")
    return "; ".join(parts)
