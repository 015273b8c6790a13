"""The sections of a scene that describe the contact: indenter, elastic body, load cell and asperities."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

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
    RadiusOrFlat,
    Section,
)


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
