"""Make the numbers of the documentation.

    python benchmarks/run.py                                   # what there is, and the page that shows it
    python benchmarks/run.py chain.accuracy --seed 40
    python benchmarks/run.py chain.accuracy --help             # its options

A subject is a function of a file beside this one; its arguments are the options. Everything runs on one core.
The battery of images (`imaging_battery.py`, `imaging_ablation.py`, `imaging_speed.py`) and
`sheared_series.py` have commands of their own.
"""

import argparse
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

SUBJECTS = {
    "analysis_closed_loop.frames": "docs/analysis.md",
    "analysis_closed_loop.contacts": "docs/analysis.md",
    "analysis_closed_loop.tables": "docs/analysis.md",
    "calibration_jkr.intervals": "docs/calibration.md",
    "calibration_jkr.errors": "docs/calibration.md",
    "calibration_jkr.frames": "docs/calibration.md",
    "calibration_threshold.closed_loop": "docs/calibration.md",
    "chain.accuracy": "docs/accuracy.md",
    "chain.coverage": "docs/uncertainty.md",
    "chain.series": "docs/uncertainty.md",
    "documented_commands.compare": "README, tutorial, how-tos, docs/effects.md",
    "effects_honesty.scenes": "docs/effects.md",
    "effects_honesty.cost": "docs/effects.md",
    "effects_honesty_optics.scenes": "docs/effects.md",
    "effects_outputs.outputs": "docs/effects.md",
    "finite_strain.table": "docs/models.md",
    "hard_cases.page": "docs/hard_cases.md",
    "models_speed.solve": "docs/models.md",
    "models_speed.scaling": "docs/models.md",
    "models_speed.plan": "docs/effects.md",
    "models_speed.boundary": "docs/models.md",
    "models_truth.errors": "docs/models.md",
    "models_truth.make": "tests/data/models_spectral_*.csv",
    "notebook_results.full": "notebooks/results/, docs/models.md",
    "notebook_results.tables": "notebooks/results/README.md, docs/models.md",
    "notebook_results.small": "notebooks/",
    "tradeoff_samples.tables": "docs/tradeoff.md",
}
"""Function of a file -> where its numbers are shown."""


def options_of(function: Callable[..., Any], words: Sequence[str]) -> dict[str, Any]:
    """The arguments of a function from the words of a command line; each has a default."""
    parser = argparse.ArgumentParser(description=inspect.getdoc(function))
    for name, parameter in inspect.signature(function).parameters.items():
        flag, default = f"--{name.replace('_', '-')}", parameter.default
        if isinstance(default, bool):
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=default)
        elif isinstance(default, tuple):
            kind = type(default[0]) if default else str
            parser.add_argument(flag, nargs="*", type=kind, default=default)
        else:
            parser.add_argument(flag, type=str if default is None else type(default), default=default)
    return vars(parser.parse_args(words))


def main(words: Sequence[str]) -> None:
    """Run a subject, or list all."""
    if not words or words[0] not in SUBJECTS:
        print("\n".join(f"{name:36} {page}" for name, page in SUBJECTS.items()))
        return
    module, name = words[0].split(".")
    function = getattr(importlib.import_module(module), name)
    function(**options_of(function, words[1:]))


if __name__ == "__main__":
    main(sys.argv[1:])
