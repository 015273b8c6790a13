"""Change keys of a scene file and leave the rest as it is written, comments included."""

from collections.abc import Mapping
from pathlib import Path

import tomlkit
from tomlkit.exceptions import TOMLKitError

from contactimg.errors import InputError
from contactimg.files.atomic import flush_to_disk, write_text
from contactimg.scene import scene_from_dict


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
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            document = tomlkit.parse(file.read())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, TOMLKitError) as error:
        raise InputError(f"{path}: is not valid TOML: {error}") from None
    if section not in document:
        document.add(tomlkit.nl())
        document.add(section, tomlkit.table())
    document[section].update(keys)
    scene_from_dict(document.unwrap(), name=str(path), folder=str(path.parent))
    write_text(document.as_string(), path)
    flush_to_disk(path)
