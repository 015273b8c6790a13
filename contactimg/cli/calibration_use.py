"""What `process` takes from a calibration: modulus, threshold and edge, each with its uncertainty."""

from collections.abc import Mapping
from typing import Any

from contactimg.errors import InputError


def apply_calibration(data: dict[str, Any], record: Mapping[str, Any], *, sets_method: bool) -> None:
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
    # a threshold holds at the modulus it was found with
    modulus = _modulus(record)
    if modulus is not None:
        data.setdefault("elastic", {})["young_modulus_Pa"] = modulus["value"]
        data["elastic"]["young_modulus_std_Pa"] = modulus.get("std") or 0.0
    measure = data.setdefault("measure", {}) if {"threshold", "edge_shift"} & set(record) else {}
    if "threshold" in record:
        measure["threshold"] = record["threshold"]["value"]
        measure["threshold_std"] = record["threshold"].get("std") or 0.0
        correlation = record.get("correlation", {}).get("threshold, young_modulus")
        measure["threshold_modulus_correlation"] = correlation or 0.0
        if sets_method and record.get("method") != "disk":
            measure.setdefault("method", "threshold")
    if "edge_shift" in record:
        measure["edge_shift_px"] = record["edge_shift"]["value"]
        measure["edge_shift_std_px"] = record["edge_shift"].get("std") or 0.0


def refuse_idle(data: dict[str, Any], record: Mapping[str, Any], path: str, method: str | None) -> None:
    """Refuse a calibration of the threshold where disks are fitted: it would change nothing.

    Raises
    ------
    InputError
        If it can act on nothing.
    """
    chosen = method or data.get("measure", {}).get("method", "disk")
    if record.get("kind") in ("threshold", "plateau") and record.get("method") != "disk" and chosen == "disk":
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
    parts, modulus = [], _modulus(record)
    if modulus is not None:
        value, std = modulus["value"] * 1e-6, (modulus.get("std") or 0.0) * 1e-6
        parts.append(f"modulus {value:.4g} +- {std:.2g} MPa on the forces")
    for name, unit, acts_on in (("threshold", "", "threshold"), ("edge_shift", " px", "disk")):
        if name in record:
            value, std = record[name]["value"], record[name].get("std") or 0.0
            where = "on all radii" if method == acts_on else f"on nothing: the method is {method}"
            parts.append(f"{name.replace('_', ' ')} {value:.3g} +- {std:.2g}{unit} {where}")
    return "; ".join(parts)


def _modulus(record: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The modulus that a calibration found, or was made at."""
    found: Mapping[str, Any] | None = record.get("young_modulus") or record.get("fixed", {}).get(
        "young_modulus"
    )
    return found
