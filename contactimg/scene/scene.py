"""The whole scene: its sections together, and the sentence for a broken rule."""

import difflib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import PrivateAttr, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from contactimg.errors import InputError
from contactimg.scene import sections

if TYPE_CHECKING:
    from contactimg.pose import Pose


class Scene(sections.Section):
    """A whole scene: every section is optional where a command does not need it."""

    indenter: sections.Indenter | None = None
    elastic: sections.Elastic | None = None
    asperities: sections.Asperities | None = None
    camera: sections.Camera | None = None
    light: sections.FilmLight = sections.FilmLight()
    images: sections.Images = sections.Images()
    load: sections.Load = sections.Load()
    measure: sections.Measure = sections.Measure()
    tolerance: sections.Tolerance = sections.Tolerance()
    effects: sections.Effects = sections.Effects()
    simulate: sections.Simulate | None = None

    _source: dict[str, Any] = PrivateAttr(default_factory=dict)
    _folder: str = PrivateAttr(default=".")

    @property
    def source(self) -> dict[str, Any]:
        """The dict this scene was made from, with the keys as written."""
        return self._source

    @property
    def folder(self) -> str:
        """The folder that the scene's paths are relative to."""
        return self._folder

    @property
    def configuration(self) -> dict[str, Any]:
        """Every key with its value, defaults included, as a dict that gives this scene again.

        What another value replaces unless it is stated is in it only if it is.
        """
        unstated = {name: {"apex", "side"} - one.model_fields_set for name, one in self if one is not None}
        return self.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=unstated)

    @property
    def common_radius(self) -> float | None:
        """Composite radius of asperities and lens, m; None where [asperities] states no radius for all."""
        if self.asperities is None or self.asperities.radius is None:
            return None
        lens = 0.0 if self.indenter is None else 1 / self.indenter.radius
        return 1 / (1 / self.asperities.radius + lens)

    def with_apex(self, apex: tuple[float, float]) -> "Scene":
        """The scene with the indenter's apex at a point of the sample, m; itself without an indenter."""
        if self.indenter is None:
            return self
        return self.model_copy(update={"indenter": self.indenter.model_copy(update={"apex": apex})})

    def with_effects(self, switches: Mapping[str, str]) -> "Scene":
        """The scene with other switches of its effects."""
        return self.model_copy(update={"effects": self.effects.model_copy(update=switches)})

    def need(self, section: str, purpose: str) -> Any:
        """The named section, or an `InputError` that says what it is needed for."""
        value = getattr(self, section)
        if value is None:
            raise InputError(f"{purpose} needs a section [{section}] in the scene; add it")
        return value

    def check_effects(self) -> None:
        """Refuse mechanical effects without the parameter they act by.

        Raises
        ------
        InputError
            Naming the effect and the key.
        """
        elastic, effects = self.elastic, self.effects
        if elastic is None:
            return
        if effects.layer == "on" and elastic.thickness is None:
            raise InputError('[effects] layer = "on" needs the thickness_m of [elastic]; add it')
        if effects.adhesion == "on" and elastic.work_of_adhesion == 0:
            raise InputError('[effects] adhesion = "on" needs the work_of_adhesion_J_m2 of [elastic]; add it')

    def pose(self, shape: tuple[int, int]) -> "Pose":
        """The camera's pose for images of ``shape`` (rows, columns)."""
        from contactimg.pose import Pose  # noqa: PLC0415 - a command's help needs the keys, not the arrays

        camera: sections.Camera = self.need("camera", "turning pixels into metres")
        apex = self.indenter.apex if self.indenter is not None else (0.0, 0.0)
        return Pose(
            shape=shape,
            pixel_size=camera.pixel_size,
            centre=camera.centre if camera.centre is not None else apex,
            rotation=camera.rotation,
            mirrored=camera.mirrored,
        )


def scene_from_dict(data: Mapping[str, Any], *, name: str = "scene", folder: str = ".") -> Scene:
    """Validate a scene.

    Parameters
    ----------
    data : mapping
        Sections and keys as in the scene file.
    name : str
        What to call the scene in an error (the file name).
    folder : str
        What the scene's paths are relative to.

    Raises
    ------
    InputError
        One sentence on the first broken rule: section, key, rule, value, allowed keys.

    Examples
    --------
    >>> scene_from_dict({"camera": {"pixel_size_m": 6e-6}}).camera.pixel_size
    6e-06
    """
    try:
        scene = Scene.model_validate(dict(data))
    except ValidationError as error:
        details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
        raise InputError(_broken_rule(details[0], name)) from None
    scene = _with_one_light(scene, name)
    scene._source, scene._folder = dict(data), folder
    return scene


def _with_one_light(scene: Scene, name: str) -> Scene:
    """The scene with the same light in ``[light]`` and ``[simulate]``, whichever states a key."""
    keys = set(sections.FilmLight.model_fields)
    light = scene.light.model_dump(include=keys, exclude_unset=True)
    simulate = {} if scene.simulate is None else scene.simulate.model_dump(include=keys, exclude_unset=True)
    for key, value in light.items():
        if simulate.get(key, value) != value:
            raise InputError(
                f"{name}: [light] {key} ({value}) and [simulate] {key} ({simulate[key]}) "
                "differ; keep one of the two"
            )
    parts = {"light": scene.light, "simulate": scene.simulate}
    stated = {section: one and one.model_copy(update=light | simulate) for section, one in parts.items()}
    return scene.model_copy(update=stated)


def section_keys(section: str) -> dict[str, FieldInfo]:
    """The keys of a section as written in the scene file, with their meaning, bounds and default."""
    annotation = Scene.model_fields[section].annotation
    options = [annotation, *getattr(annotation, "__args__", ())]
    model = next(one for one in options if isinstance(one, type) and issubclass(one, sections.Section))
    return {field.alias or attribute: field for attribute, field in model.model_fields.items()}


RULES = {
    "model_type": "must be a section of keys",
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text in quotes",
    "string_too_short": "must not be empty",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "too_long": "must have no more than {max_length} items",
}
"""Kind of a broken rule, as pydantic names it -> the rule; others are said in pydantic's words."""


def _broken_rule(detail: ErrorDetails, name: str) -> str:
    """One sentence for one validation error of the scene that is called ``name``."""
    section, *keys = detail["loc"]
    if detail["type"] == "extra_forbidden":
        allowed = list(section_keys(str(section)) if keys else Scene.model_fields)
        what = f"[{section}] has no key {str(keys[0])!r}" if keys else f"unknown section [{section}]"
        close = difflib.get_close_matches(str(keys[0] if keys else section), allowed, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"{name}: {what}{hint} (allowed {'keys' if keys else 'sections'}: {', '.join(allowed)})"
    places = (f"[{key}]" if isinstance(key, int) else f" {key}" for key in keys)
    where = f"{name}: [{section}]{''.join(places)}"
    if detail["type"] == "missing":
        return f"{where} is missing; add it"
    if detail["type"] == "value_error":
        return f"{where}{'' if keys else ':'} {detail['msg'].removeprefix('Value error, ')}"
    rule = RULES.get(detail["type"], "").format(**detail.get("ctx", {}))
    return f"{where} {rule or detail['msg'].replace('Input should', 'must', 1)}, got {detail['input']!r}"
