"""From a folder and options to a scene: options replace keys of the scene file."""

from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from contactimg.cli.calibration_use import apply_calibration, describe_use, refuse_idle
from contactimg.cli.shared_options import SceneOptions
from contactimg.errors import InputError
from contactimg.files import (
    SCENE_FILE,
    is_reference,
    list_frames,
    named_file,
    read_calibration,
    read_scene,
    read_scene_asperities,
    read_scene_loads,
)
from contactimg.plausibility import doubts_about_scene, settle
from contactimg.scene import Scene, scene_from_dict

SCENE_KEYS = {
    "reference": ("images", "reference"),
    "frames": ("images", "frames"),
    "loads": ("images", "loads"),
    "polarity": ("images", "polarity"),
    "method": ("measure", "method"),
    "shape": ("measure", "shape"),
    "threshold": ("measure", "threshold"),
    "pixel_size_m": ("camera", "pixel_size_m"),
}
"""Option -> section and key of the scene that it replaces."""

PATHS = ("reference", "loads")
"""Options that name files, relative to the working directory."""


def scene_of_folder(folder: str | Path, options: SceneOptions) -> Scene:
    """The scene of a folder of frames.

    Parameters
    ----------
    folder : path-like
        With a ``scene.toml``, or with frames only.
    options : SceneOptions

    Raises
    ------
    InputError
        If the scene file or an option breaks a rule.
    """
    folder = Path(folder)
    if folder.is_file():
        raise InputError(f"{folder} is a file; give the folder that holds the frames")
    stated = {field.name: getattr(options, field.name) for field in fields(SceneOptions)}
    given = {key: value for key, value in stated.items() if value not in (None, ())}
    data, base = _base_scene(folder, given.pop("scene", None))
    if given.pop("calibration", None) is not None:
        record = read_calibration(str(options.calibration))
        apply_calibration(data, record, sets_method=options.method is None)
        refuse_idle(data, record, str(options.calibration), options.method)
    if options.pixel_size_um is not None:
        given["pixel_size_m"] = given.pop("pixel_size_um") * 1e-6
    for option, value in given.items():
        section, key = SCENE_KEYS[option]
        data.setdefault(section, {})[key] = _plain(option, value)
    return plausible(scene_from_dict(data, name="the options and the scene", folder=str(base)))


def plausible(scene: Scene) -> Scene:
    """The scene, unless physics makes one of its values doubtful.

    Raises
    ------
    InputError
        For a value that is probably a slip (`contactimg.plausibility`), without ``--no-plausibility``.
    """
    asperities, loads = None, list[float]()
    with suppress(InputError):  # a file that cannot be read: the command itself says so
        asperities = read_scene_asperities(scene)
        loads = read_scene_loads(scene)
    settle(doubts_about_scene(scene, asperities, loads), str(Path(scene.folder)))
    return scene


def calibration_record(path: str | None, scene: Scene) -> dict[str, Any]:
    """The calibration that a run used, for its provenance: the file, its contents and what acts on what."""
    if path is None:
        return {}
    record = read_calibration(path)
    acts = describe_use(record, method=scene.measure.method)
    return {"calibration": {"file": path, "record": record, "acts": acts}}


def model_inputs(path: str | Path, scene: Scene) -> list[Path]:
    """The files that a prediction depends on: the scene file and its asperity table."""
    path = Path(path)
    files = [path / SCENE_FILE if path.is_dir() else path]
    if scene.asperities is not None and scene.asperities.file is not None:
        files.append(Path(scene.folder) / scene.asperities.file)
    return files


def with_tolerance(scene: Scene, *, output: str | None, relative: float | None) -> Scene:
    """The scene with the tolerance that the options give; None keeps that of the scene.

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
    """The sections of the scene file and the folder its paths are relative to.

    A folder without a scene file gets a scene with the reference only, if one of its images has that name.
    """
    if scene_file is not None:
        return _moved_to(folder, read_scene(scene_file)), folder
    if (folder / SCENE_FILE).exists():
        return _copied(read_scene(folder)), folder
    reference = [source.path for source in list_frames(folder) if is_reference(source.path)]
    return {"images": {"reference": reference[0].name}} if len(reference) == 1 else {}, folder


def _moved_to(folder: Path, scene: Scene) -> dict[str, Any]:
    """The sections of a scene file that lies elsewhere; files missing in the folder are those beside it."""
    data = _copied(scene)
    keys = [("images", key) for key in ("reference", "loads", "dark", "flat", "mask", "edits")]
    for section, key in (*keys, ("asperities", "file")):
        named = data.get(section, {}).get(key)
        if named is not None and (isinstance(named, str) or key == "reference"):
            entries = [named] if isinstance(named, str) else named
            found = [_beside(name, folder, Path(scene.folder)) for name in entries]
            data[section][key] = found[0] if isinstance(named, str) else found
    return data


def _beside(name: str, folder: Path, scene_folder: Path) -> str:
    """The name if the folder has such files, else the path beside the scene file."""
    relative = not Path(name).is_absolute()
    there = named_file(name, folder).exists() or (relative and any(folder.glob(name)))
    return name if there else str((scene_folder / name).resolve())


def _copied(scene: Scene) -> dict[str, Any]:
    """A copy of the sections as written."""
    return {section: dict(keys) for section, keys in scene.source.items()}


def _plain(option: str, value: Any) -> Any:
    """The value as a scene holds it: paths absolute, the threshold as a number unless it is a word."""
    if option in PATHS:
        paths = [str(Path(name).resolve()) for name in ([value] if isinstance(value, str) else value)]
        return paths[0] if len(paths) == 1 else paths
    if option != "threshold":
        return value
    try:
        return float(value)
    except ValueError:
        return value
