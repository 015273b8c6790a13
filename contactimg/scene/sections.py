"""The sections of a scene beside those of the contact: camera, images, measurement, effects, simulation."""

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from contactimg.scene.rules import (
    Angle,
    Count,
    CountFrom1,
    FilePath,
    Fraction,
    Frames,
    MaskArea,
    NonNegative,
    Number,
    OpenFraction,
    Point,
    Positive,
    Section,
    Side,
    Switch,
    YesNo,
    must_be,
)

MAX_PIXELS = 200_000_000
"""Largest image and largest synthetic frame, px: 1.6 GB in double precision, twelve times a camera of 16
megapixels. Chosen: it stops headers that lie and decompression bombs, for which an environment variable
replaces it (`contactimg.files.decoders.MAX_PIXELS_VARIABLE`), and catches slips of the pen."""

MIN_ELECTRONS_PER_LEVEL = 1e-3
"""Smallest number of electrons per grey level above 0. Chosen: below it every pixel is noise."""


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
    response: list[Point] | None = Field(
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
        "that lowers the noise.",
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
"""Switches of the paper's model."""


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

    def switches(self) -> dict[str, Switch]:
        """Effect -> its switch, in order."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "model"}

    def switched_off(self, *names: str) -> frozenset[str]:
        """The named effects that are "off"."""
        return frozenset(name for name in names if getattr(self, name) == "off")


class Simulate(FilmLight):
    """Optics and sensor of synthetic frames; the keys ``film_*`` are aliases of those of ``[light]``.

    An optical or sensor effect under ``"auto"`` is rendered if its parameter here is not zero, the air film
    only where it is switched on; ``contactimg simulate`` renders what the plan of the effects calls for. The
    bounds lie far beyond any camera: they stop a slip of the pen from requesting a frame that fits in no
    memory.
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
    supersampling: Annotated[CountFrom1, Field(le=16)] = Field(
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
