"""The tests' renderer, which shares nothing with the package, for the benchmarks."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from contact_frames import CAMERAS, Optics, coverage, expose, match, render, scatter, surface_texture

__all__ = ["CAMERAS", "Optics", "coverage", "expose", "match", "render", "scatter", "surface_texture"]
