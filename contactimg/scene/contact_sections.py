"""The sections of a scene that describe the contact: indenter, elastic body, load cell and asperities."""

import math
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from contactimg.errors import InputError
from contactimg.scene.rules import (
    Angle,
    Count,
    FilePath,
    Fraction,
    NonNegative,
    Number,
    OpenFraction,
    Point,
    Positive,
    Section,
    Tilt,
)


class Indenter(Section):
    """The smooth sphere, or the textured lens."""

    radius: Positive = Field(alias="radius_m", description="Radius of curvature of the lens, m.")
    apex: Point = Field(
        (0.0, 0.0), alias="apex_m", description="Sample point (x, y) below the apex of the indenter, m."
    )
    tilt: Tilt = Field(
        0.0,
        alias="tilt_deg",
        description="Tilt of the indenter about its apex, degrees; a sphere touches as if its apex were "
        "shifted by radius times tilt.",
    )
    tilt_direction: Angle = Field(
        0.0,
        alias="tilt_direction_deg",
        description="Direction towards which the tilted indenter comes nearer to the sample, from +x "
        "towards +y, degrees.",
    )

    @property
    def slope(self) -> tuple[float, float]:
        """How much nearer the tilted indenter is per length along x and y."""
        slope = math.tan(self.tilt)
        return slope * math.cos(self.tilt_direction), slope * math.sin(self.tilt_direction)


class Sample(Section):
    """The shape of the sample below its asperities, flat if not stated; it adds to the gap."""

    radius_x: Number | None = Field(
        None,
        alias="radius_x_m",
        description="Radius of curvature along x, m: positive if the sample bulges towards the indenter, "
        "negative if it is hollow; flat along x if not given.",
    )
    radius_y: Number | None = Field(
        None,
        alias="radius_y_m",
        description="The same along y; one of the two alone makes a cylinder, equal ones a sphere.",
    )
    summit: Point = Field(
        (0.0, 0.0), alias="summit_m", description="Highest (or lowest) point (x, y) of the sample, m."
    )

    @field_validator("radius_x", "radius_y")
    @classmethod
    def _radius(cls, value: float | None) -> float | None:
        if value == 0:
            raise ValueError("must not be 0; leave it out for a flat sample")
        return value

    @property
    def flat(self) -> bool:
        """Whether there is no curvature."""
        return self.radius_x is None and self.radius_y is None

    @property
    def curvature(self) -> tuple[float, float]:
        """Curvatures along x and y, 1/m."""
        first, second = (0.0 if radius is None else 1 / radius for radius in (self.radius_x, self.radius_y))
        return first, second


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
            raise InputError("[elastic] young_modulus_Pa is missing: Young's modulus in Pa; add it")
        return self.stated_modulus

    @property
    def contact_modulus(self) -> float:
        """E* = E/(1 - nu^2), Pa: the partner is rigid."""
        return self.young_modulus / (1 - self.poisson_ratio**2)


class Load(Section):
    """The load cell: its stiffness, and how well its zero and gain are known (errors of all loads)."""

    zero_std: NonNegative | None = Field(
        None,
        alias="zero_std_N",
        description="Standard uncertainty of what the load cell reads without load, N. A zero is fitted only "
        "where this is given; else the loads are taken as they are.",
    )
    gain_std: Fraction | None = Field(
        None, description="Relative standard uncertainty of the gain of the load cell; 0.01 if not given."
    )
    stiffness: Positive | None = Field(
        None,
        alias="stiffness_N_m",
        description="Stiffness of the load cell and the frame of the instrument, N/m, where `predict` is "
        "given displacements of the stage; rigid if not given.",
    )
    tangential_direction: Angle = Field(
        0.0,
        alias="tangential_direction_deg",
        description="Direction on the sample of a positive tangential load, from +x_m towards +y_m, degrees.",
    )
    path: Literal["loading", "unloading"] | Annotated[list[Number], Field(max_length=1000)] = Field(
        "loading",
        description="How adhesive contacts reach a load: at first loading, by unloading from the larger "
        "loads of the same command one after the other, or after these loads (N) in this order. Contacts "
        "that have formed last until they break.",
    )

    @property
    def before(self) -> tuple[float, ...]:
        """The loads (N) before every load, where they are listed."""
        return () if isinstance(self.path, str) else tuple(self.path)


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

    profile_exponent: Positive | None = Field(
        None,
        description="Asperities of the profile drop = profile_drop_m "
        "(r/profile_width_m)^profile_exponent instead of caps: 1 for cones, 2 for paraboloids. radius_m of "
        "the table remains the radius by which the slope of the lens shifts the summits.",
    )
    profile_width: Positive | None = Field(
        None, alias="profile_width_m", description="Distance from the axis of an asperity, m."
    )
    profile_drop: Positive | None = Field(
        None, alias="profile_drop_m", description="Drop below the summit at profile_width_m, m."
    )
    profile_points: list[Point] | None = Field(
        None,
        alias="profile_points_m",
        description="Asperities of a tabulated axisymmetric profile instead: pairs of "
        "distance from the axis and drop below the summit, m, both increasing from [0, 0].",
    )

    @property
    def profiled(self) -> bool:
        """Whether the asperities have a stated profile instead of caps."""
        return self.profile_exponent is not None or self.profile_points is not None

    @model_validator(mode="after")
    def _one_profile(self) -> "Asperities":
        power = (self.profile_exponent, self.profile_width, self.profile_drop)
        stated = [value is not None for value in power]
        if any(stated) and not all(stated):
            raise ValueError("profile_exponent, profile_width_m and profile_drop_m belong together; give all")
        if any(stated) and self.profile_points is not None:
            raise ValueError("profile_points_m and profile_exponent are both given; keep one of the two")
        return self

    @model_validator(mode="after")
    def _one_source(self) -> "Asperities":
        if self.file is not None and self.generate is not None:
            raise ValueError("file and generate are both given; keep one of the two")
        if self.height_min is not None and self.height_max is not None and self.height_max < self.height_min:
            raise ValueError(
                f"height_max_m ({self.height_max}) must not be below height_min_m ({self.height_min})"
            )
        return self
