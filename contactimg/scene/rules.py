"""What all sections of a scene share: the types of their keys and the rules of a section."""

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    WrapValidator,
)

FLAT = "flat"
"""What a radius may be instead of a number."""


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
CountFrom1 = Annotated[int, Field(strict=True, ge=1)]
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
