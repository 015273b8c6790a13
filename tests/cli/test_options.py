"""A command is made of a function, and an option of a key of the scene."""

import re
from typing import Annotated, Literal

import click
import pytest
from click.testing import CliRunner

from contactimg.cli import commands
from contactimg.cli.options import Count, NonNegative, SceneOption, command
from contactimg.scene import section_keys

SEEN = {}


@command(SceneOption("--lens-radius-mm", "indenter", "radius_m"))
def draw_lines(
    name: str,
    others: Annotated[tuple[str, ...], "OTHER..."] = (),
    *,
    stated: dict,
    load_std_N: NonNegative = 0.5,
    lines: Annotated[tuple[float, ...], "--line-m"] = (),
    kind: Literal["solid", "dashed"] = "solid",
    grid: bool = False,
    labels: Annotated[bool, "--labels/--no-labels"] = True,
    count: Count | None = None,
) -> int:
    """Draw lines on NAME.

    Parameters
    ----------
    load_std_N
        Standard uncertainty of a load,
        in newtons.
    lines
        Where a line is.
    """
    SEEN.clear()
    SEEN.update(locals())
    return 0


def run(*words):
    return CliRunner().invoke(draw_lines, [str(word) for word in words], standalone_mode=False)


def test_names_types_and_defaults_are_those_of_the_signature():
    assert draw_lines.name == "draw-lines"
    assert run("a").exception is None
    assert SEEN == {
        "name": "a", "others": (), "stated": {}, "load_std_N": 0.5, "lines": (), "kind": "solid",
        "grid": False, "labels": True, "count": None,
    }  # fmt: skip
    words = ["a", "b", "c", "--load-std-N", 1, "--line-m", 2, "--line-m", 3, "--kind", "dashed", "--grid"]
    assert run(*words, "--no-labels", "--count", 4, "--lens-radius-mm", 128.8).exception is None
    assert SEEN == {
        "name": "a", "others": ("b", "c"), "stated": {"indenter": {"radius_m": 0.1288}}, "load_std_N": 1.0,
        "lines": (2.0, 3.0), "kind": "dashed", "grid": True, "labels": False, "count": 4,
    }  # fmt: skip


@pytest.mark.parametrize(
    "words", [[], ["a", "--load-std-N", -1], ["a", "--kind", "dotted"], ["a", "--count", 0]]
)
def test_what_breaks_a_rule_of_the_signature_is_a_usage_error(words):
    assert isinstance(run(*words).exception, click.UsageError)


def test_the_help_is_the_docstring_and_the_meaning_of_the_key():
    text = " ".join(CliRunner().invoke(draw_lines, ["--help"]).output.split())
    assert "Draw lines on NAME. Options:" in text
    assert "--load-std-N FLOAT RANGE Standard uncertainty of a load, in newtons." in text
    assert '--lens-radius-mm NUMBER Radius of curvature of the lens, mm; "flat" for a flat plate.' in text
    assert section_keys("indenter")["radius_m"].description == (
        'Radius of curvature of the lens, m; "flat" for a flat plate.'
    )


@pytest.mark.parametrize("value", [6, 5.9, 0.1, 1 / 3, 6.123456789])
def test_a_unit_adds_no_digits(value):
    option = SceneOption("--pixel-size-um", "camera", "pixel_size_m")
    assert option.in_scene(float(value)) == pytest.approx(float(f"{value!r}e-6"), rel=1e-14)
    assert option.in_scene(5.9) == 5.9e-6


OPTIONS = """
analyse: --annulus-mm --calibration --cluster --friction-std-N --load-relative-std --load-std-N
    --load-tolerance --min-radius-px --models/--no-models -o/--output --smooth --workers
asperities: --depth --form --height-unit --min-height-um -o/--output --pixel-size-um
calibrate jkr: --cluster --frames --loads --no-plausibility -o/--output --pixel-size-um --polarity
    --reference --scene --workers
calibrate modulus: --calibration --cluster --frames --jkr --loads --no-plausibility -o/--output
    --pixel-size-um --polarity --reference --scene --threshold --workers --young-modulus-MPa
    --young-modulus-std-MPa
calibrate plateau: --cluster --frames --loads --no-plausibility -o/--output --pixel-size-um --polarity
    --reference --scene --workers
calibrate threshold: --cluster --frames --jkr --loads --no-plausibility -o/--output --pixel-size-um
    --polarity --reference --scene --workers --young-modulus-MPa --young-modulus-std-MPa
effects: --load-N --no-plausibility -o --output --tolerance
export: --fiji --labels --napari --no-plausibility -o/--output --units --xlsx
import-rois: --author --frame --no-plausibility -o/--output
init: --force --lens-radius-mm --no-input --no-plausibility --pixel-size-um --young-modulus-MPa
overlay: --min-radius-px --no-plausibility -o/--output --workers
predict: --annulus-mm --cluster --coupling --load-N --model --no-plausibility
    -o/--output --tolerance --workers
process: --calibration --cluster --format --frames --loads --method --no-plausibility
    -o/--output --pictures/--no-pictures --pixel-size-um --polarity --reference
    --scene --shape --threshold --workers
report: --max-pictures -o/--output --with
review: --no-browser --port --workers
simulate: --cluster --no-plausibility -o/--output --workers
tradeoff: --knob --load-N --no-plausibility -o/--output --tolerance
"""
"""Names that users script against, beside --quiet, --verbose and --timings, which every command has."""


@pytest.mark.parametrize("line", re.sub(r"\n +", " ", OPTIONS.strip()).splitlines())
def test_every_option_is_there(line):
    names, options = line.split(": ")
    command = commands
    for name in names.split():
        command = command.get_command(click.Context(command), name)
    there = {"/".join([*param.opts, *param.secondary_opts]) for param in command.params}
    assert there >= {*options.split(), "--quiet", "--verbose", "--timings"}


@pytest.mark.parametrize("name", ["check", "design"])
def test_a_seed_is_not_negative(name):
    seed = next(
        param for param in commands.get_command(click.Context(commands), name).params if param.name == "seed"
    )
    with pytest.raises(click.BadParameter, match="not in the range x>=0"):
        seed.type.convert("-1", seed, None)
