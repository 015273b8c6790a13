"""What all sections of a scene share: the types of their keys and the rules of a section."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

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
MaskArea = FilePath | list[Annotated[list[Point], Field(min_length=3)]]
Side = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Switch = Literal["auto", "on", "off"]


class Section(BaseModel):
    """Common rules of all sections: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)
