"""What provenance.json must hold for a run to be read back."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from contactimg.errors import InputError
from contactimg.files.calibrations import check_calibration

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
Count = Annotated[int, Field(strict=True, ge=0)]
Size = Annotated[int, Field(strict=True, ge=1, le=10**6)]
Text = Annotated[str, Field(strict=True)]
YesNo = Annotated[bool, Field(strict=True)]


class _Part(BaseModel):
    """A part of the record; what else it holds is kept."""

    model_config = ConfigDict(extra="allow", frozen=True)


class PoseRecord(_Part):
    """The pose of the camera."""

    rows: Size
    columns: Size
    pixel_size_m: Positive
    centre_m: tuple[Number, Number]
    rotation_deg: Number
    mirrored: YesNo
    fitted: YesNo
    n_points: Count
    n_matched: Count
    residual_m: Annotated[Number, Field(ge=0)] | None


class _UsedCalibration(_Part):
    """The calibration that a run was measured with."""

    file: Text
    record: dict[str, Any]


class _Options(_Part):
    """Settings that are not in the scene."""

    calibration: _UsedCalibration | None = None


class _Configuration(_Part):
    """Scene and options."""

    scene: dict[str, Any] | None = None
    scene_folder: Text = "."
    scene_folder_relative: Text | None = None
    options: _Options = _Options()


class _InputFile(_Part):
    """A file that was read."""

    path: Text
    sha256: Text | None = None


class RunRecord(_Part):
    """The record of a run."""

    schema_version: Annotated[int, Field(strict=True, ge=1)]
    command: Text
    created: Text = ""
    configuration: _Configuration
    inputs: list[_InputFile] = []
    outputs: list[Text] = []
    pose: PoseRecord | None = None


def check_record(record: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """The record of a run, with every key that the commands read.

    Parameters
    ----------
    record : mapping
        From `contactimg.files.read_records`.
    file : Path
        The provenance.json, for the message.

    Raises
    ------
    InputError
        If a key is missing or has another type; the message names it.
    """
    try:
        checked = RunRecord.model_validate(dict(record))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(key) for key in first["loc"])
        raise InputError(f"{file}: is damaged ({place}: {first['msg']}); repeat the run") from None
    used = checked.configuration.options.calibration
    if used is not None:
        check_calibration(used.record, f"{file}: the calibration of the run")
    return {"created": checked.created, "inputs": [], **record}
