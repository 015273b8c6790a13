"""Read ``calibration.json``, the result of a calibration."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from contactimg.errors import InputError
from contactimg.files.output import finish_commit

CALIBRATION_FILE = "calibration.json"


def read_calibration(path: str | Path) -> dict[str, Any]:
    """Read the result of `calibrate`.

    Parameters
    ----------
    path : path-like
        The file, or the folder that holds it.

    Returns
    -------
    dict
        For each number ``{"value": , "std": , "unit": }``, and how it was obtained.

    Raises
    ------
    InputError
        If the file cannot be read, is no JSON object, or a value in it is no number.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "calibration.json"
    ...     _ = file.write_text('{"threshold": {"value": 0.43, "std": 0.02, "unit": ""}}')
    ...     read_calibration(folder)["threshold"]["value"]
    0.43
    """
    path = Path(path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    finish_commit(path.parent)
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({error}); give the calibration.json of `calibrate`") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: must hold an object; give the calibration.json of `calibrate`")
    check_calibration(record, str(path))
    return record


NUMBERS = (
    "young_modulus",
    "work_of_adhesion",
    "centre_x",
    "centre_y",
    "threshold",
    "slope",
    "threshold_low",
    "threshold_high",
    "edge_shift",
)
"""Names of the numbers that a calibration may hold."""


def check_calibration(record: Mapping[str, Any], place: str) -> None:
    """Raise an `InputError` if a number of a calibration is none, or has no value."""
    for name, entry in record.items():
        numbers = isinstance(entry, dict) and {"value", "unit"} <= set(entry)
        if name in NUMBERS and not (isinstance(entry, dict) and "value" in entry):
            raise InputError(f"{place}: {name} must hold a value, got {entry!r}")
        if not (numbers or name in NUMBERS):
            continue
        if not _is_number(entry["value"]):
            raise InputError(f"{place}: the value of {name} must be a number, got {entry['value']!r}")
        std = entry.get("std")
        if std is not None and not (_is_number(std) and std >= 0):
            raise InputError(f"{place}: the std of {name} must be a number that is not negative, got {std!r}")


def _is_number(value: object) -> bool:
    """Whether a value of JSON is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def shares_frames(record: Mapping[str, Any], inputs: list[dict[str, Any]]) -> bool:
    """Whether a calibration used one of the frames among these inputs (as `provenance` lists them)."""
    digests = [
        {
            entry.get("sha256")
            for entry in listed
            if not str(entry.get("path", "")).endswith((".csv", ".toml"))
        }
        for listed in (record.get("frames", []), inputs)
    ]
    return bool((digests[0] & digests[1]) - {None})
