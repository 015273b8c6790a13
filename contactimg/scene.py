"""The scene: one description of an experiment, measured or simulated, validated at the door.

Keys carry their unit (``radius_m``); the attributes of the records do not (``radius``) and hold SI floats,
pixel lengths apart (``_px``). An unknown key, a missing key or a value out of range is an `InputError` whose
sentence names the section, the key, the rule, the value got and, for an unknown key, the allowed keys.
"""

import difflib
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from contactimg.errors import InputError
from contactimg.pose import Pose

# strict: text and true/false are not numbers
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0)]
CountFrom1 = Annotated[int, Field(strict=True, ge=1)]
YesNo = Annotated[bool, Field(strict=True)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Fraction = Annotated[Number, Field(ge=0, le=1)]
OpenFraction = Annotated[Number, Field(gt=0, lt=1)]
Point = tuple[Number, Number]
FilePath = Annotated[str, Field(min_length=1)]
Side = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Switch = Literal["auto", "on", "off"]

MOST_PIXELS = 200_000_000
"""Of a synthetic frame: 1.6 GB in double precision."""

FEWEST_ELECTRONS = 1e-3
"""To a grey level of a synthetic frame."""


INCOMPRESSIBLE = 0.49
"""Poisson's ratio from which on a body counts as incompressible."""


class _Section(BaseModel):
    """Common rules of all sections: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


class Indenter(_Section):
    """The smooth sphere (or the textured lens): radius of curvature and where its apex stands, m."""

    radius: Positive = Field(alias="radius_m")
    apex: Point = Field((0.0, 0.0), alias="apex_m")


class Elastic(_Section):
    """The elastic body; Pa, m, J/m^2. Without a thickness it is a half-space."""

    young_modulus: Positive = Field(alias="young_modulus_Pa")
    young_modulus_std: NonNegative = Field(0.0, alias="young_modulus_std_Pa")
    poisson_ratio: Annotated[Number, Field(gt=-1, le=0.5)] = 0.5
    thickness: Positive | None = Field(None, alias="thickness_m")
    work_of_adhesion: NonNegative = Field(0.0, alias="work_of_adhesion_J_m2")

    @property
    def contact_modulus(self) -> float:
        """E* = E/(1 - nu^2), Pa: the partner is rigid."""
        return self.young_modulus / (1 - self.poisson_ratio**2)


class Asperities(_Section):
    """The asperities: a table, a generator, or the parameters of a statistical model."""

    file: FilePath | None = None
    generate: Literal["SA", "RA-", "RA+"] | None = None
    coverage: OpenFraction | None = None
    side: Positive = Field(0.01, alias="side_m")
    seed: Count = 0
    textured: Literal["soft", "rigid"] = "soft"
    density: Positive | None = Field(None, alias="density_per_m2")
    radius: Positive | None = Field(None, alias="radius_m")
    height_law: Literal["uniform", "gaussian"] | None = None
    height_min: Number | None = Field(None, alias="height_min_m")
    height_max: Number | None = Field(None, alias="height_max_m")
    height_mean: Number | None = Field(None, alias="height_mean_m")
    height_std: NonNegative | None = Field(None, alias="height_std_m")

    @model_validator(mode="after")
    def _one_source(self) -> "Asperities":
        if self.file is not None and self.generate is not None:
            raise ValueError("file and generate are both given; keep one of the two")
        if self.height_min is not None and self.height_max is not None and self.height_max < self.height_min:
            raise ValueError(
                f"height_max_m ({self.height_max}) must not be below height_min_m ({self.height_min})"
            )
        return self


class Camera(_Section):
    """How the sample is seen; m and rad. Without a centre the image is centred on the apex.

    ``full_scale_levels`` is the grey level at which the sensor saturates, for cameras whose files do not say
    it (12 bits in 16: 4095); without it that of the file, else of its dtype, holds.
    """

    pixel_size: Positive = Field(alias="pixel_size_m")
    centre: Point | None = Field(None, alias="centre_m")
    rotation: Annotated[Number, AfterValidator(math.radians), PlainSerializer(math.degrees)] = Field(
        0.0, alias="rotation_deg"
    )
    mirrored: YesNo = False
    full_scale: Positive | None = Field(None, alias="full_scale_levels")


class Images(_Section):
    """The frames of the experiment, by paths relative to the scene file.

    Without ``frames``: the images called ``frame_*``, failing that every image of the folder but the
    reference. Without ``loads``: ``loads.csv`` if there is one.
    """

    reference: FilePath | None = None
    frames: str | list[str] | None = None
    loads: FilePath | None = None
    polarity: Literal["bright", "dark", "auto"] = "bright"

    @field_validator("frames", mode="before")
    @classmethod
    def _frames(cls, value: Any) -> Any:
        entries = value if isinstance(value, list) else [value]
        if value is not None and not (entries and all(isinstance(entry, str) and entry for entry in entries)):
            raise ValueError(f"must be a file, a glob or a list of these, got {value!r}")
        return value


class Measure(_Section):
    """How contacts are measured; ``blur_px`` (standard deviation) is estimated from the frame if not given.

    ``pose = "fit"`` corrects the camera's pose with the matched asperities, ``"given"`` takes it as is.
    """

    method: Literal["threshold", "disk"] = "disk"
    threshold: OpenFraction | Literal["auto"] = 0.5
    blur_px: Positive | None = None
    pose: Literal["fit", "given"] = "fit"

    @field_validator("threshold", mode="wrap")
    @classmethod
    def _threshold(cls, value: Any, handler: Any) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(
                f'must be a number between 0 and 1 (exclusive) or "auto", got {value!r}'
            ) from None


class Tolerance(_Section):
    """Which output must be accurate, and to what relative change."""

    output: Literal["area", "force", "radius"] = "area"
    relative: Positive = 0.01


class Effects(_Section):
    """One switch an effect; ``full_coupling`` refines ``coupling``.

    ``supersampling`` is the renderer's depth: "on" as [simulate] says, "off" no deeper than the blur needs.
    """

    coupling: Switch = "auto"
    full_coupling: Switch = "auto"
    adhesion: Switch = "auto"
    layer: Switch = "auto"
    sphere_profile: Switch = "auto"
    blur: Switch = "auto"
    film: Switch = "auto"
    vignetting: Switch = "auto"
    light_drift: Switch = "auto"
    position_drift: Switch = "auto"
    shot_noise: Switch = "auto"
    read_noise: Switch = "auto"
    quantisation: Switch = "auto"
    saturation: Switch = "auto"
    dust: Switch = "auto"
    edge_roughness: Switch = "auto"
    supersampling: Switch = "auto"

    def switched_off(self, *names: str) -> frozenset[str]:
        """Those of the named effects that are "off"."""
        return frozenset(name for name in names if getattr(self, name) == "off")


class Simulate(_Section):
    """Optics and sensor of synthetic frames.

    Grey levels are those of the camera; ``contrast_levels`` is contact minus background at the image centre.
    `contactimg.render` shows an optical or sensor effect under ``"auto"`` when its parameter here is not
    zero, the air film only when it is switched on; ``contactimg simulate`` shows what the plan of the effects
    calls for. Loads may be negative, a pull, where adhesion bears it. The bounds lie far
    beyond any camera: they keep a slip of the pen from asking for a frame that no memory holds.
    """

    loads: list[Number] = Field([], alias="loads_N")
    shape: tuple[Side, Side] = (1200, 1600)
    background_levels: Annotated[Positive, Field(le=1e6)] = 80.0
    contrast_levels: Annotated[Number, Field(ge=-1e6, le=1e6)] = 100.0
    brightness_spread: Fraction = 0.0
    blur_px: Annotated[NonNegative, Field(le=100)] = 1.4
    psf: Literal["gaussian", "halo", "airy"] = "gaussian"
    halo_fraction: Fraction = 0.2
    halo_sigma_px: Annotated[Positive, Field(le=500)] = 8.0
    edge_softness_px: Annotated[NonNegative, Field(le=100)] = 0.0
    edge_roughness_px: Annotated[NonNegative, Field(le=1000)] = 0.0
    vignetting: Fraction = 0.0
    texture: Fraction = 0.0
    dust_count: Annotated[Count, Field(le=100_000)] = 0
    light_drift: Annotated[Number, Field(gt=-1, le=100)] = 0.0
    position_drift_px: Annotated[NonNegative, Field(le=1e5)] = 0.0
    electrons_per_level: Annotated[NonNegative, Field(le=1e9)] = 0.0
    read_noise_electrons: Annotated[NonNegative, Field(le=1e9)] = 0.0
    bit_depth: Literal[8, 10, 12, 14, 16] = 8
    supersampling: Annotated[CountFrom1, Field(le=16)] = 4
    film_index_indenter: Positive = 1.52
    film_index_elastic: Positive = 1.41
    film_wavelength_nm: Positive = 560.0
    film_bandwidth_nm: Positive = 70.0
    film_range_nm: tuple[Positive, Positive] = (450.0, 680.0)
    seed: Count = 0

    @field_validator("electrons_per_level", mode="after")
    @classmethod
    def _electrons(cls, value: float) -> float:
        if 0 < value < FEWEST_ELECTRONS:
            raise ValueError(f"must be 0 (no noise) or at least {FEWEST_ELECTRONS:g}, got {value:g}")
        return value

    @field_validator("shape", mode="after")
    @classmethod
    def _shape(cls, value: tuple[int, int]) -> tuple[int, int]:
        if math.prod(value) > MOST_PIXELS:
            raise ValueError(f"must have no more than {MOST_PIXELS:.0e} pixels, got {math.prod(value):.1e}")
        return value


_SectionType = TypeVar("_SectionType", bound=_Section)


class Scene(_Section):
    """A whole scene: every section is optional where a command does not need it."""

    indenter: Indenter | None = None
    elastic: Elastic | None = None
    asperities: Asperities | None = None
    camera: Camera | None = None
    images: Images = Images()
    measure: Measure = Measure()
    tolerance: Tolerance = Tolerance()
    effects: Effects = Effects()
    simulate: Simulate | None = None

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
        """Every key with its value, defaults included, as a dict that gives this scene again."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def need(self, section: str, purpose: str) -> Any:
        """The named section, or an `InputError` that says what it is needed for."""
        value = getattr(self, section)
        if value is None:
            raise InputError(f"{purpose} needs a section [{section}] in the scene; add it")
        return value

    def check_effects(self) -> None:
        """Refuse mechanical effects without the parameter they act by, or outside their range.

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
        if (
            elastic.thickness is not None
            and effects.layer != "off"
            and elastic.poisson_ratio < INCOMPRESSIBLE
        ):
            raise InputError(
                "[elastic] thickness_m: the layer is that of an incompressible body, poisson_ratio = 0.5, "
                f'got {elastic.poisson_ratio:g}; leave the thickness out, or set [effects] layer = "off"'
            )

    def pose(self, shape: tuple[int, int]) -> Pose:
        """The camera's pose for images of ``shape`` (rows, columns)."""
        camera: Camera = self.need("camera", "turning pixels into metres")
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
        raise InputError(_sentence(details[0], name)) from None
    scene._source, scene._folder = dict(data), folder
    return scene


def _sentence(detail: ErrorDetails, name: str) -> str:
    """One sentence for one validation error."""
    section, *keys = detail["loc"]
    if detail["type"] == "extra_forbidden":
        return _unknown_key(name, str(section), str(keys[0]) if keys else None)
    where = f"{name}: [{section}]" + "".join(_place(key) for key in keys)
    if detail["type"] == "missing":
        return f"{where} is missing; add it"
    if detail["type"] == "value_error":
        return f"{where}{'' if keys else ':'} {detail['msg'].removeprefix('Value error, ')}"
    return f"{where} {_rule(detail)}, got {detail['input']!r}"


def _place(key: int | str) -> str:
    """A key, or a place in a list."""
    return f"[{key}]" if isinstance(key, int) else f" {key}"


def _rule(detail: ErrorDetails) -> str:
    """The broken rule in plain words."""
    context = detail.get("ctx", {})
    rules = {
        "model_type": "must be a section of keys",
        "bool_type": "must be true or false",
        "float_type": "must be a number",
        "int_type": "must be a whole number",
        "string_type": "must be text in quotes",
        "string_too_short": "must not be empty",
        "list_type": "must be a list",
        "tuple_type": "must be a list",
        "too_long": f"must have no more than {context.get('max_length')} items",
    }
    return rules.get(detail["type"], detail["msg"].replace("Input should", "must", 1))


def _unknown_key(name: str, section: str, key: str | None) -> str:
    """The sentence for a key or section that does not exist, with the allowed ones."""
    if key is None:
        allowed, what = _keys(Scene), f"{name}: unknown section [{section}]"
        wrong, kind = section, "sections"
    else:
        annotation = Scene.model_fields[section].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(o for o in options if isinstance(o, type) and issubclass(o, _Section))
        allowed, what = _keys(model), f"{name}: [{section}] has no key {key!r}"
        wrong, kind = key, "keys"
    close = difflib.get_close_matches(wrong, allowed, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"{what}{hint} (allowed {kind}: {', '.join(allowed)})"


def _keys(model: type[_Section]) -> list[str]:
    """Names of a section's keys as written in the scene file."""
    return [field.alias or attribute for attribute, field in model.model_fields.items()]
