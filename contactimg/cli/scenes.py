"""From a folder and options to a scene: what the scene file says holds unless an option says otherwise."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from contactimg.errors import InputError
from contactimg.files import (
    SCENE_FILE,
    is_reference,
    list_frames,
    named_file,
    read_calibration,
    read_scene,
)
from contactimg.scene import Scene, scene_from_dict

OPTION_KEYS = {
    "reference": ("images", "reference"),
    "frames": ("images", "frames"),
    "loads": ("images", "loads"),
    "polarity": ("images", "polarity"),
    "method": ("measure", "method"),
    "threshold": ("measure", "threshold"),
    "pixel_size_m": ("camera", "pixel_size_m"),
}
PATHS = ("reference", "loads")
"""Options that name files, relative to where the command is typed."""


def scene_of_folder(folder: str | Path, options: Mapping[str, Any]) -> Scene:
    """The scene of a folder of frames.

    Parameters
    ----------
    folder : path-like
        With a ``scene.toml``, or with frames only.
    options : mapping
        Of the command; None where an option is not given.

    Raises
    ------
    InputError
        If the scene file or an option breaks a rule.
    """
    folder, given = Path(folder), {key: value for key, value in options.items() if value is not None}
    if folder.is_file():
        raise InputError(f"{folder} is a file; give the folder that holds the frames")
    data, base = _base_scene(folder, given.pop("scene", None))
    calibration = given.pop("calibration", None)
    if calibration is not None:
        _calibrate(data, read_calibration(calibration), threshold_counts="method" not in given)
    if "pixel_size_um" in given:
        given["pixel_size_m"] = given.pop("pixel_size_um") * 1e-6
    for key, value in given.items():
        section, name = OPTION_KEYS[key]
        data.setdefault(section, {})[name] = _plain(key, value)
    return scene_from_dict(data, name="the options and the scene", folder=str(base))


def _calibrate(data: dict[str, Any], record: Mapping[str, Any], *, threshold_counts: bool) -> None:
    """Let a scene's sections hold what a calibration found: modulus, threshold, and the method it is for."""
    if "young_modulus" in record:
        entry = record["young_modulus"]
        data.setdefault("elastic", {})["young_modulus_Pa"] = entry["value"]
        data["elastic"]["young_modulus_std_Pa"] = entry.get("std") or 0.0
    if "threshold" in record:
        measure = data.setdefault("measure", {})
        measure["threshold"] = record["threshold"]["value"]
        if threshold_counts and record.get("method") != "disk":
            measure.setdefault("method", "threshold")


def calibration_options(path: str | Path | None) -> dict[str, Any]:
    """What the provenance says of a calibration that was used: its file and all that it holds."""
    return {} if path is None else {"calibration": {"file": str(path), "record": read_calibration(path)}}


def model_inputs(path: str | Path, scene: Scene) -> list[Path]:
    """Files that a prediction depends on: the scene file and the asperity table it names."""
    path = Path(path)
    files = [path / SCENE_FILE if path.is_dir() else path]
    if scene.asperities is not None and scene.asperities.file is not None:
        files.append(Path(scene.folder) / scene.asperities.file)
    return files


def with_tolerance(scene: Scene, *, output: str | None, relative: float | None) -> Scene:
    """The scene with the tolerance that options give.

    Raises
    ------
    InputError
        If the tolerance breaks its rule.
    """
    given = {"output": output, "relative": relative}
    given = {key: value for key, value in given.items() if value is not None}
    data = scene.source | {"tolerance": scene.source.get("tolerance", {}) | given}
    return scene_from_dict(data, name="the options and the scene", folder=scene.folder)


def _base_scene(folder: Path, scene_file: str | None) -> tuple[dict[str, Any], Path]:
    """Sections of the scene file and the folder its paths are relative to; a bare folder makes its own."""
    if scene_file is not None:
        return _moved_to(folder, read_scene(scene_file)), folder
    if (folder / SCENE_FILE).exists():
        return _copied(read_scene(folder)), folder
    reference = [source.path for source in list_frames(folder) if is_reference(source.path)]
    return {"images": {"reference": reference[0].name}} if len(reference) == 1 else {}, folder


def _moved_to(folder: Path, scene: Scene) -> dict[str, Any]:
    """A scene from elsewhere for the frames of a folder; other files are looked for there, then beside it."""
    data = _copied(scene)
    for section, key in (("images", "reference"), ("images", "loads"), ("asperities", "file")):
        named = data.get(section, {}).get(key)
        if named is not None and not named_file(named, folder).exists():
            data[section][key] = str((Path(scene.folder) / named).resolve())
    return data


def _copied(scene: Scene) -> dict[str, Any]:
    """The scene as written, its sections free to change."""
    return {section: dict(keys) for section, keys in scene.source.items()}


def _plain(key: str, value: Any) -> Any:
    """A path is absolute; a threshold is a number unless it is a word."""
    if key in PATHS:
        return str(Path(value).resolve())
    if key != "threshold":
        return value
    try:
        return float(value)
    except ValueError:
        return value
