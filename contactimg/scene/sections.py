"""The sections of a scene: the types of their keys, and every section with its keys and their meaning."""

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    WrapValidator,
    field_validator,
    model_validator,
)

from contactimg.errors import InputError

MAX_PIXELS = 200_000_000
"""Largest image and largest synthetic frame, px: 1.6 GB in double precision, twelve times a camera of 16
megapixels. Chosen: it stops headers that lie and decompression bombs, and catches slips of the pen."""

MIN_ELECTRONS_PER_LEVEL = 1e-3
"""Smallest number of electrons per grey level above 0. Chosen: below it every pixel is noise."""

FLAT = "flat"
"""What a radius may be instead of a number."""


# --- what all sections share: types of keys, and the rules of a section


def must_be(rule: str) -> WrapValidator:
    """Say the whole rule of a key in one sentence, whichever part of it is broken."""

    def check(value: Any, handler: Any) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(f"must be {rule}, got {value!r}") from None

    return WrapValidator(check)


# strict: text and true/false are not numbers
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0)]
YesNo = Annotated[bool, Field(strict=True)]
Positive = Annotated[Number, Field(gt=0)]
# a flat has an infinite radius, which JSON cannot hold
RadiusOrFlat = Annotated[
    float,
    Field(strict=True, gt=0, allow_inf_nan=True),
    BeforeValidator(lambda value: math.inf if value == FLAT else value),
    PlainSerializer(lambda value: FLAT if math.isinf(value) else value),
]
NonNegative = Annotated[Number, Field(ge=0)]
Fraction = Annotated[Number, Field(ge=0, le=1)]
OpenFraction = Annotated[Number, Field(gt=0, lt=1)]
Point = tuple[Number, Number]
# an angle is written in degrees
Angle = Annotated[Number, AfterValidator(math.radians), PlainSerializer(math.degrees)]
FilePath = Annotated[str, Field(min_length=1)]
Frames = Annotated[
    FilePath | Annotated[list[FilePath], Field(min_length=1)] | None,
    must_be("a file, a glob or a list of these"),
]
MaskArea = FilePath | list[Annotated[list[Point], Field(min_length=3)]]
Side = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Switch = Literal["auto", "on", "off"]


class Section(BaseModel):
    """Common rules of all sections: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


# --- the contact: indenter, elastic body, load cell and asperities


class Indenter(Section):
    """The smooth sphere, or the textured lens."""

    radius: RadiusOrFlat = Field(
        alias="radius_m", description='Radius of curvature of the lens, m; "flat" for a flat plate.'
    )
    apex: Point = Field(
        (0.0, 0.0), alias="apex_m", description="Sample point (x, y) below the apex of the indenter, m."
    )


class Elastic(Section):
    """The elastic body; its partner is rigid."""

    stated_modulus: Positive | None = Field(
        None,
        alias="young_modulus_Pa",
        description="Young's modulus E, Pa; needed wherever it is not what is sought.",
    )
    young_modulus_std: NonNegative = Field(
        0.0, alias="young_modulus_std_Pa", description="Standard uncertainty of E, Pa."
    )
    poisson_ratio: Annotated[Number, Field(gt=-1, le=0.5)] = Field(0.5, description="Poisson's ratio nu.")
    thickness: Positive | None = Field(
        None, alias="thickness_m", description="Thickness of the elastic layer, m; a half-space if not given."
    )
    work_of_adhesion: NonNegative = Field(
        0.0, alias="work_of_adhesion_J_m2", description="Work of adhesion w, J/m^2."
    )

    @property
    def young_modulus(self) -> float:
        """Young's modulus E, Pa, or an `InputError` that says that it is missing."""
        if self.stated_modulus is None:
            raise InputError(
                "[elastic] young_modulus_Pa is missing: Young's modulus in Pa; add it to the scene"
            )
        return self.stated_modulus

    @property
    def contact_modulus(self) -> float:
        """E* = E/(1 - nu^2), Pa: the partner is rigid."""
        return self.young_modulus / (1 - self.poisson_ratio**2)


class Load(Section):
    """The load cell: how well its zero and gain are known (errors of all loads)."""

    zero_std: NonNegative | None = Field(
        None,
        alias="zero_std_N",
        description="Standard uncertainty of what the load cell reads without load, N. A zero is fitted only "
        "where this is given; else the loads are taken as they are.",
    )
    gain_std: Fraction | None = Field(
        None, description="Relative standard uncertainty of the gain of the load cell; 0.01 if not given."
    )
    tangential_direction: Angle = Field(
        0.0,
        alias="tangential_direction_deg",
        description="Direction on the sample of a positive tangential load, from +x_m towards +y_m, degrees.",
    )


class Asperities(Section):
    """The asperities: a table, a generator, or the parameters of a statistical model."""

    file: FilePath | None = Field(
        None, description="CSV table of the asperities with columns x_m, y_m, height_m, radius_m."
    )
    generate: Literal["SA", "RA-", "RA+"] | None = Field(
        None, description="Generate a pattern of this kind instead of reading a file."
    )
    coverage: OpenFraction | None = Field(
        None, description="Fraction of the area that a generated pattern covers with asperities."
    )
    side: Positive = Field(0.01, alias="side_m", description="Side of the square that the pattern fills, m.")
    seed: Count = Field(0, description="Seed of the random numbers of a generated pattern.")
    textured: Literal["soft", "rigid"] = Field(
        "soft", description="Which body carries the asperities: the elastic one (SA) or the lens (RA)."
    )
    density: Positive | None = Field(
        None,
        alias="density_per_m2",
        description="Asperities per unit area for gw and gt, 1/m^2; derived from the table if not given.",
    )
    radius: Positive | None = Field(
        None,
        alias="radius_m",
        description="Radius of curvature common to all asperities, m; that of the table if not given.",
    )
    height_law: Literal["uniform", "gaussian"] | None = Field(
        None, description="Height distribution for gw and gt; that of the table if not given."
    )
    height_min: Number | None = Field(
        None, alias="height_min_m", description="Smallest height of the uniform distribution, m."
    )
    height_max: Number | None = Field(
        None, alias="height_max_m", description="Largest height of the uniform distribution, m."
    )
    height_mean: Number | None = Field(
        None, alias="height_mean_m", description="Mean height of the Gaussian distribution, m."
    )
    height_std: NonNegative | None = Field(
        None, alias="height_std_m", description="Standard deviation of the Gaussian distribution, m."
    )

    surroundings: Literal["none", "mean_field"] = Field(
        "none",
        description="What lies around the table: nothing, or the mean field (gt) of the same asperities, "
        "which bears its share of the load and displaces the surface.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> "Asperities":
        if self.file is not None and self.generate is not None:
            raise ValueError("file and generate are both given; keep one of the two")
        if self.height_min is not None and self.height_max is not None and self.height_max < self.height_min:
            raise ValueError(
                f"height_max_m ({self.height_max}) must not be below height_min_m ({self.height_min})"
            )
        return self


# --- camera, light, images, measurement, effects, simulation


class Camera(Section):
    """The camera and its view of the sample."""

    pixel_size: Positive = Field(alias="pixel_size_m", description="Length on the sample of one pixel, m.")
    centre: Point | None = Field(
        None,
        alias="centre_m",
        description="Sample point (x, y) at the centre of the image, m; the apex if not given.",
    )
    rotation: Angle = Field(
        0.0, alias="rotation_deg", description="Rotation of the image, +x towards +y, degrees."
    )
    mirrored: YesNo = Field(default=False, description="Whether +y of the sample points up in the image.")
    full_scale: Positive | None = Field(
        None,
        alias="full_scale_levels",
        description="Grey level at which the sensor saturates (4095 for 12 bits in 16-bit files); "
        "that of the file or of its pixel type if not given.",
    )
    gamma: Annotated[Number, Field(ge=0.1, le=10)] = Field(
        1.0,
        description="Exponent of the camera's response: grey level over full scale = (light over light at "
        "full scale)^gamma; 1 for a linear camera, 0.45 for most video cameras. Frames and reference are "
        "linearised when they are read.",
    )
    response: tuple[Point, ...] | None = Field(
        None,
        description="Response of the camera as a table instead: pairs of grey level and relative light, "
        "both increasing.",
    )

    linearity: Annotated[Number, Field(ge=0, lt=1)] = Field(
        0.01,
        description="Standard uncertainty of the response at mid-level after that, of the contrast: no image "
        "shows it, and it moves all edges; 0 for a camera that is known to be linear.",
    )

    @model_validator(mode="after")
    def _one_response(self) -> "Camera":
        if self.response is None:
            return self
        if self.gamma != 1.0:
            raise ValueError("gamma and response are both given; keep one of the two")
        levels, light = zip(*self.response, strict=True) if self.response else ((), ())
        rising = all(b > a for row in (levels, light) for a, b in pairwise(row))
        if len(levels) < 2 or not rising:  # a straight line has two rows
            raise ValueError(
                "response must be two or more pairs of grey level and relative light, both increasing, "
                f"got {self.response}"
            )
        return self


class FilmLight(Section):
    """The real lamp and the media that its light crosses: they shape the fringes of the air film at an edge.

    `process` and the effects use it with ``[effects] film = "on"``, `calibrate jkr` always, `simulate` where
    the film is rendered. The keys of the same name in ``[simulate]`` are aliases; a key that stands in both
    sections must have the same value in both.
    """

    film_index_indenter: Positive = Field(1.52, description="Refractive index of the indenter (glass).")
    film_index_elastic: Positive = Field(1.41, description="Refractive index of the elastic body (PDMS).")
    film_wavelength_nm: Positive = Field(560.0, description="Centre of the lamp's spectrum, nm.")
    film_bandwidth_nm: Positive = Field(
        70.0, description="1/e half-width of the lamp's spectrum, a Gaussian in wavelength, nm."
    )
    film_range_nm: tuple[Positive, Positive] = Field(
        (450.0, 680.0), description="Shortest and longest wavelength that the camera detects, nm."
    )


class Images(Section):
    """The frames of the experiment, by paths relative to the scene file."""

    reference: Frames = Field(
        None,
        description="The non-contact frame, or several of them (a glob, a list, a multi-page file), which "
        "are averaged; if not given, the background is estimated from each frame.",
    )
    background: Literal["auto", "reference", "pooled"] = Field(
        "auto",
        description="What is subtracted from each frame: the reference, or the background pooled from all "
        'frames of the series together. "auto": pooled for the method "disk" and five frames or more, where '
        'that lowers the noise. Unless "reference" is stated, one that shows contacts is left out.',
    )
    frames: Frames = Field(
        None,
        description="The frames: a glob, a list, or one multi-page TIFF or .seq file; if not given, frame_*, "
        "or else every image of the folder except the reference.",
    )
    loads: FilePath | None = Field(
        None,
        description="CSV table of the loads: frame, load_N and optionally friction_N, velocity_m_s, "
        "tangential_N, time_s; "
        "if not given, loads.csv where it exists.",
    )
    polarity: Literal["bright", "dark", "auto"] = Field(
        "bright", description="Whether contacts are brighter or darker than the background."
    )
    mask: Annotated[
        MaskArea | dict[str, MaskArea] | None,
        must_be(
            "a file, a list of polygons (each a list of at least three points [x, y] in px), or these by "
            "frame"
        ),
    ] = Field(
        None,
        description="What to leave out of every frame: an image (pixels other than 0 are left out), an "
        "ImageJ file of regions (.roi, .zip), or a list of polygons, each a list of [x, y] in px; or one of "
        'these for each frame: { "frame_3.tif" = "scratch.png", "*" = "dirt.zip" }, with "*" for all frames.',
    )
    dark: Frames = Field(
        None,
        description="Dark frame, subtracted from frames and reference: a file, a glob or a list of these, of "
        "which the mean is taken.",
    )
    flat: Frames = Field(
        None,
        description="Flat field (an evenly lit field of view) that frames and reference are divided by, "
        "after the dark frame was subtracted: a file, a glob or a list of these, of which the mean is taken.",
    )
    edits: FilePath | None = Field(
        None,
        description="CSV table of corrections by hand: frame, action, x_px, y_px, radius_px, points; if not "
        "given, edits.csv where it exists.",
    )

    @property
    def masks(self) -> dict[str, "MaskArea"]:
        """Name of a frame, or ``*`` for all, and what to leave out of it."""
        if self.mask is None:
            return {}
        return self.mask if isinstance(self.mask, dict) else {"*": self.mask}


class Measure(Section):
    """The method by which contacts are measured."""

    method: Literal["threshold", "disk"] = Field(
        "disk", description='"threshold": the pixel count of the paper; "disk": fit of blurred disks.'
    )
    threshold: Annotated[
        OpenFraction | Literal["auto"], must_be('a number between 0 and 1 (exclusive) or "auto"')
    ] = Field(
        0.5, description='Threshold of the pixel count as a fraction of the contact contrast, or "auto".'
    )
    threshold_std: NonNegative = Field(0.0, description="Standard uncertainty of the threshold.")
    threshold_modulus_correlation: Annotated[Number, Field(ge=-1, le=1)] = Field(
        0.0, description="Correlation of threshold and modulus, as `calibrate threshold` states it."
    )
    blur_px: Positive | None = Field(
        None, description="Standard deviation of the optical blur, px; found from the frame if not given."
    )
    edge_shift_px: Number = Field(0.0, description="Seeming edge minus true one, px; taken off the radii.")
    edge_shift_std_px: NonNegative | None = Field(None, description="Its standard uncertainty, px.")
    film_doubt: Annotated[Number, Field(ge=0, le=0.5)] = Field(
        0.2, description='Probability that a film stated "on" or "off" is a mistake; 0: known for certain.'
    )
    shape: Literal["auto", "disk", "ellipse", "free"] = Field(
        "auto",
        description='Shape of the contacts, for the method "disk". "auto": a disk, an ellipse or a free '
        "shape, as the pixels of each call for; the others: all contacts alike.",
    )
    registration: Literal["strips", "whole"] = Field(
        "strips",
        description="What of an image the shift of a frame is found from; all of it takes longer and makes "
        "displacements of contacts more accurate.",
    )
    pose: Literal["fit", "given"] = Field(
        "fit",
        description="Whether the pose of the camera is corrected with the asperities, or kept as given.",
    )

    @model_validator(mode="after")
    def _known_edge(self) -> Self:
        if self.edge_shift_px and self.edge_shift_std_px is None:
            raise ValueError(
                f"edge_shift_px = {self.edge_shift_px:g} needs edge_shift_std_px, its standard uncertainty "
                "(0 if it is exact)"
            )
        return self


class Tolerance(Section):
    """Which output must be accurate, and how accurate."""

    output: Literal["all", "area", "force", "radius", "profile"] = Field(
        "all",
        description="The output that must be accurate: every one that is written, or only the area, the "
        "forces, the contact radii or the profiles.",
    )
    relative: Positive = Field(0.01, description="Largest relative error that may be tolerated.")


PAPER_MODEL: dict[str, Switch] = {
    "coupling": "on",
    "full_coupling": "off",
    "adhesion": "off",
    "layer": "off",
    "sphere_profile": "off",
}
"""Switches of the paper's model, one for each mechanical effect."""


class Effects(Section):
    """One switch per effect: "auto" leaves the decision to the plan of the effects."""

    model: Literal["planned", "paper"] = Field(
        "planned",
        description='"planned": the plan decides on mechanical effects that are "auto"; "paper": these are '
        "the paper's, coupling by point forces and Hertz's law.",
    )
    coupling: Switch = Field("auto", description="Elastic interaction of the contacts (point forces).")
    full_coupling: Switch = Field(
        "auto", description="Interaction with the finite size of the contacts; needs coupling."
    )
    adhesion: Switch = Field("auto", description="Adhesion of the contacts (JKR).")
    layer: Switch = Field("auto", description="Finite thickness of the elastic body.")
    sphere_profile: Switch = Field("auto", description="Exact profile of the asperities, not a paraboloid.")
    blur: Switch = Field("auto", description="Optical blur.")
    film: Switch = Field("auto", description="Interference in the air film around contacts.")
    vignetting: Switch = Field("auto", description="Illumination that falls off towards the corners.")
    light_drift: Switch = Field("auto", description="Brightness that differs between frame and reference.")
    position_drift: Switch = Field("auto", description="Shift of the frame against its reference.")
    shot_noise: Switch = Field("auto", description="Noise of the photoelectrons.")
    read_noise: Switch = Field("auto", description="Noise of the sensor's electronics.")
    quantisation: Switch = Field("auto", description="Rounding to whole grey levels.")
    saturation: Switch = Field("auto", description="Clipping at the full scale of the sensor.")
    dust: Switch = Field("auto", description="Dust and dirt in the light path.")
    edge_roughness: Switch = Field("auto", description="Contacts whose outline departs from a circle.")
    supersampling: Switch = Field(
        "auto", description='Depth of rendering: "on" as [simulate] states, "off" no deeper than blur needs.'
    )

    @model_validator(mode="before")
    @classmethod
    def _paper(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("model") != "paper":
            return data
        auto = {name: switch for name, switch in PAPER_MODEL.items() if data.get(name, "auto") == "auto"}
        return data | auto

    @property
    def law(self) -> Literal["hertz", "sphere"]:
        """The law of a contact's force without adhesion that the switches call for."""
        return "sphere" if self.sphere_profile == "on" else "hertz"

    def switches(self) -> dict[str, Switch]:
        """Effect -> its switch, in order."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "model"}

    def switched_off(self, *names: str) -> frozenset[str]:
        """The named effects that are "off"."""
        return frozenset(name for name in names if getattr(self, name) == "off")


class Simulate(FilmLight):
    """Optics and sensor of synthetic frames; the keys ``film_*`` are aliases of those of ``[light]``.

    An optical or sensor effect under ``"auto"`` is rendered if its parameter here is not zero, the air film
    only where it is switched on. Of the mechanical effects, ``contactimg simulate`` computes those that the
    plan of the effects calls for. The bounds lie far beyond any camera: they stop a slip of the pen from
    requesting a frame that fits in no memory.
    """

    loads: list[Number] = Field(
        [], alias="loads_N", description="Normal loads, N; a negative load is a pull that adhesion must bear."
    )
    tangential: list[Number] = Field(
        [],
        alias="tangential_N",
        description="Tangential loads, N, one for each of loads_N; the contacts share each as their areas.",
    )
    interval: NonNegative = Field(
        0.0, alias="interval_s", description="Time between frames, s; 0 for frames without a time."
    )
    shear_beta: NonNegative = Field(
        0.0,
        alias="shear_beta_m5_N2",
        description="beta, m^5/N^2: under its tangential load q a contact shrinks along it to the area "
        "A0 - beta A0^(-3/2) q^2.",
    )
    shear_compliance: Number = Field(
        0.0,
        alias="shear_compliance_m_N",
        description="Displacement of all contacts along the tangential load, over that load, m/N.",
    )
    shape: tuple[Side, Side] = Field((1200, 1600), description="Rows and columns of the frames.")
    background_levels: Annotated[Positive, Field(le=1e6)] = Field(
        80.0, description="Grey level of the background at the centre of the image."
    )
    contrast_levels: Annotated[Number, Field(ge=-1e6, le=1e6)] = Field(
        100.0, description="Contact minus background at the centre of the image, grey levels."
    )
    brightness_spread: Fraction = Field(
        0.0, description="Relative standard deviation of the contrast between contacts."
    )
    blur_px: Annotated[NonNegative, Field(le=100)] = Field(
        1.4, description="Standard deviation of the optical blur, px."
    )
    psf: Literal["gaussian", "halo", "airy"] = Field(
        "gaussian", description="Point spread function: Gaussian, Gaussian with a wide halo, or Airy disk."
    )
    halo_fraction: Fraction = Field(0.2, description="Fraction of the light that goes into the halo.")
    halo_sigma_px: Annotated[Positive, Field(le=500)] = Field(
        8.0, description="Standard deviation of the halo, px."
    )
    edge_softness_px: Annotated[NonNegative, Field(le=100)] = Field(
        0.0, description="Width of the edge of a contact before the blur, px."
    )
    edge_roughness_px: Annotated[NonNegative, Field(le=1000)] = Field(
        0.0, description="RMS departure of the outline of a contact from a circle, px."
    )
    vignetting: Fraction = Field(0.0, description="Relative loss of illumination in the corners.")
    texture: Fraction = Field(0.0, description="Relative RMS of the structure of the background.")
    dust_count: Annotated[Count, Field(le=100_000)] = Field(0, description="Number of dust grains.")
    light_drift: Annotated[Number, Field(gt=-1, le=100)] = Field(
        0.0, description="Relative change of brightness from the reference to the frames."
    )
    position_drift_px: Annotated[NonNegative, Field(le=1e5)] = Field(
        0.0, description="Standard deviation of the shift of a frame against the reference, px."
    )
    electrons_per_level: Annotated[NonNegative, Field(le=1e9)] = Field(
        0.0, description="Photoelectrons per grey level; 0 for frames without noise."
    )
    read_noise_electrons: Annotated[NonNegative, Field(le=1e9)] = Field(
        0.0, description="Standard deviation of the read noise, electrons."
    )
    bit_depth: Literal[8, 10, 12, 14, 16] = Field(8, description="Bits of a pixel.")
    supersampling: Annotated[int, Field(strict=True, ge=1, le=16)] = Field(
        4, description="Subpixels per pixel in each direction when rendering."
    )
    seed: Count = Field(0, description="Seed of the random numbers of the frames.")

    @model_validator(mode="after")
    def _tangential(self) -> Self:
        if self.tangential and len(self.tangential) != len(self.loads):
            raise ValueError(
                f"tangential_N must have one value for each of the {len(self.loads)} loads_N, "
                f"got {len(self.tangential)}"
            )
        return self

    @field_validator("electrons_per_level", mode="after")
    @classmethod
    def _electrons(cls, value: float) -> float:
        if 0 < value < MIN_ELECTRONS_PER_LEVEL:
            raise ValueError(f"must be 0 (no noise) or at least {MIN_ELECTRONS_PER_LEVEL:g}, got {value:g}")
        return value

    @field_validator("shape", mode="after")
    @classmethod
    def _shape(cls, value: tuple[int, int]) -> tuple[int, int]:
        if math.prod(value) > MAX_PIXELS:
            raise ValueError(f"must have no more than {MAX_PIXELS:.0e} pixels, got {math.prod(value):.1e}")
        return value
