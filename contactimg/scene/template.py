"""A first scene file: what is known, with the meaning of each key beside it."""

import textwrap
from collections.abc import Mapping
from typing import Any

import tomli_w
from pydantic.fields import FieldInfo

from contactimg.scene.contact_sections import Asperities, Elastic, Indenter
from contactimg.scene.rules import Section
from contactimg.scene.sections import Camera, Images, Measure

_WIDTH = 100  # characters of a comment line

SHOWN: dict[str, tuple[type[Section], tuple[str, ...]]] = {
    "indenter": (Indenter, ("radius_m", "apex_m")),
    "elastic": (Elastic, ("young_modulus_Pa", "young_modulus_std_Pa", "poisson_ratio", "thickness_m")),
    "asperities": (Asperities, ("file", "textured")),
    "camera": (Camera, ("pixel_size_m", "centre_m", "rotation_deg", "full_scale_levels", "gamma")),
    "images": (Images, ("reference", "frames", "loads", "polarity", "mask", "dark", "flat")),
    "measure": (Measure, ("method", "threshold", "shape")),
}
"""Section -> its description and the keys that most experiments need."""


def scene_template(known: Mapping[str, Mapping[str, Any]]) -> str:
    """Text of a scene file with comments.

    Parameters
    ----------
    known : mapping
        Section -> key as in the file -> value. The other keys of `SHOWN` stand as comments, with their
        defaults; a section without a known key is all comment.

    Returns
    -------
    str
        TOML.

    Examples
    --------
    >>> print(scene_template({"camera": {"pixel_size_m": 6e-6}}).split("[camera]")[1].splitlines()[2])
    pixel_size_m = 6e-06
    """
    parts = [
        "# What this experiment is. Lines that begin with # are not read: take the # away where a value is",
        "# known, and before the name of its section.",
    ]
    for name, (section, keys) in SHOWN.items():
        parts += ["", f"[{name}]" if known.get(name) else f"# [{name}]"]
        fields = {field.alias or own: field for own, field in section.model_fields.items()}
        for key in keys:
            parts += _lines(key, fields[key], known.get(name, {}))
    return "\n".join(parts) + "\n"


def _lines(key: str, field: FieldInfo, known: Mapping[str, Any]) -> list[str]:
    """The meaning of a key, and its line."""
    comment = textwrap.wrap(str(field.description), _WIDTH, initial_indent="# ", subsequent_indent="# ")
    if key in known:
        return [*comment, _toml(key, known[key])]
    default = None if field.is_required() else field.default
    line = f"# {key} =" if default is None else f"# {_toml(key, default)}"
    return [*comment, line]


def _toml(key: str, value: Any) -> str:
    """A key and its value on one line."""
    if isinstance(value, (list, tuple)):
        items = ", ".join(_toml("x", item).removeprefix("x = ") for item in value)
        return f"{key} = [{items}]"
    return tomli_w.dumps({key: value}).strip()
