"""Corrections by hand in the fit: the changed disks and their neighbours are fitted to the pixels again."""

from collections.abc import Sequence

import numpy as np

from contactimg.imaging.detect.hand_edits import EditedDisks, HandEdit, edit_disks
from contactimg.imaging.fit.disks import FitControl, FittedDisks, fit_disks
from contactimg.imaging.fit.problem import RADIUS, FitProblem, X, Y

ITERATIONS = 12
"""Of the fit from starting values drawn by hand, which may be off by a radius. Chosen by hand."""


def fit_edited(
    problem: FitProblem, fit: FittedDisks, edits: Sequence[HandEdit]
) -> tuple[FittedDisks, EditedDisks]:
    """The fit after the corrections, and which of its disks they concern."""
    binning, offset = problem.binning, (problem.binning - 1) / 2
    places = np.column_stack([problem.in_frame(fit.disks[:, [X, Y]]), fit.disks[:, RADIUS] * binning])
    image = problem.image if binning == 1 else np.kron(problem.image, np.ones((binning, binning), np.float32))
    edited = edit_disks(places, edits, image)
    new = edited.places[edited.new]
    fresh = np.column_stack(
        [(new[:, :2] - offset) / binning, new[:, 2] / binning, np.full(len(new), problem.contrast)]
    )
    if not len(new) and len(edited.source) == len(fit.disks):
        return fit, edited  # an excluded disk goes on explaining its light
    disks = np.vstack([fit.disks[edited.source[~edited.new]], fresh])
    control = FitControl(free_blur=False, robust=False, iterations=ITERATIONS)
    return fit_disks(problem, disks, blur=fit.blur, control=control), edited
