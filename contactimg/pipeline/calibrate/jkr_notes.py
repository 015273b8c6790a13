"""What `calibrate jkr` says in words: what was left out, fitted, assumed, and what the frames cannot tell."""

import pandas as pd

from contactimg.calibration.jkr import HYSTERESIS, JkrCalibration
from contactimg.calibration.jkr_uncertainties import suggested_layer, suggested_zero
from contactimg.pipeline.calibrate.circles import mean_astigmatism
from contactimg.scene import Scene
from contactimg.scene.scene import INCOMPRESSIBLE_POISSON_RATIO

FEW_LOADS = 5
"""Number of different loads below which the fit tests its law with two loads or fewer."""

BEYOND_PRIOR = 3.0
"""Zero over its stated uncertainty from which the two contradict each other. Theory: 0.3 % by chance."""


def calibration_notes(calibration: JkrCalibration, circles: pd.DataFrame, scene: Scene) -> list[str]:
    """Sentences for a person.

    Parameters
    ----------
    calibration : JkrCalibration
    circles : DataFrame
        Columns of `contactimg.tables.CIRCLES`, all frames.
    scene : Scene

    Returns
    -------
    list of str
    """
    left_out = circles[circles["radius_m"].notna() & (circles["used"] == 0)]
    return [
        *(str(text) for text in circles["message"] if text),
        *(
            f"{name}: left out of the fit, its load and radius do not go with those of the other frames"
            for name in left_out["frame"]
        ),
        *_zero_notes(calibration),
        *_edge_notes(calibration),
        *_departure_notes(calibration),
        *_series_notes(calibration),
        *_lens_notes(circles),
        *_layer_notes(calibration, scene),
        *_cell_notes(calibration, scene),
    ]


def _edge_notes(calibration: JkrCalibration) -> list[str]:
    """What to say of an edge that lies elsewhere than it seems, or of one that the loads do not settle."""
    edge = calibration.edge
    if edge is None:
        return []
    stated = f"{edge.shift.value:+.3g} +- {edge.shift.std:.2g} px"
    if edge.seen:
        note = (
            f"the edge seems to lie {stated} outside the true one: the radii were corrected; `process "
            "--calibration` takes it off the radii of other contacts"
        )
        return [note]
    used = "" if edge.settled else "; too uncertain to act on other contacts"
    return [f"the edge lies where it seems, to {stated}{used}"]


def _zero_notes(calibration: JkrCalibration) -> list[str]:
    """What to say of a zero of the loads that the frames show to be off."""
    zero, stated = calibration.load_zero, calibration.problem.series.zero_std
    if zero is None:
        asked = suggested_zero(calibration)
        if asked is None:
            return []
        note = (
            f"the frames ask for a zero of the loads of {1e3 * asked:.3g} mN, which was not fitted: state "
            "zero_std_N in [load] if the load cell may be off so far, or correct the loads"
        )
        return [note]
    if not calibration.load_zero_seen:
        return []
    note = (
        f"the loads are off by {1e3 * zero.value:.3g} +- {1e3 * zero.std:.2g} mN: their zero was fitted and "
        "taken off; correct the loads of the other folders of this load cell too"
    )
    if abs(zero.value) > BEYOND_PRIOR * stated:
        note += f". This is far more than the {1e3 * stated:.2g} mN stated: check the loads"
    return [note]


def _departure_notes(calibration: JkrCalibration) -> list[str]:
    """What made unloading differ from loading."""
    name, rival = calibration.departure, calibration.rival
    if not name:
        return []
    note = f"the order of the loads matters: a {name} was fitted"
    if name == HYSTERESIS:
        note = "unloading adheres more or less than loading: each branch has its own work of adhesion"
    if rival:
        note += (
            f"; a {rival} explains the frames nearly as well, and the difference is in the uncertainties; "
            "repeat the first load at the end to tell them apart"
        )
    return [note]


def _series_notes(calibration: JkrCalibration) -> list[str]:
    """What a short series, or one of a single branch, cannot tell."""
    points = calibration.points[calibration.points["used"].astype(bool)]
    count, notes = points["load_N"].nunique(), []
    if count < FEW_LOADS:
        notes.append(
            f"{count} different loads: they hardly test the law, and the zero of the loads is not checked; "
            "five or more do"
        )
    branches = set(points["branch"])
    if branches == {"unloading"}:
        notes.append(
            "the loads only fall: the work of adhesion is that of unloading, which for rubber often exceeds "
            "that of loading; E does not depend on it"
        )
    elif branches == {"loading"}:
        notes.append(
            "the loads only rise: hysteresis of adhesion and drift of the load cell cannot be seen; "
            "w is that of loading"
        )
    return notes


def _lens_notes(circles: pd.DataFrame) -> list[str]:
    """What to say of contacts that are ellipses."""
    lens = mean_astigmatism(circles)
    if not lens.seen:
        return []
    curvatures = 100 * 1.5 * (lens.axis_ratio - 1)
    note = (
        f"the contacts are ellipses, axes {lens.axis_ratio:.4f} +- {lens.axis_ratio_std:.1g} to 1: the "
        f"lens's radii of curvature differ by {curvatures:.2g} % (or pixels are not square); radius_m must "
        f"be their geometric mean, and E is uncertain by {100 * lens.curvature_std:.2g} % unless it is"
    )
    return [note]


def _layer_notes(calibration: JkrCalibration, scene: Scene) -> list[str]:
    """What to say of the thickness of the layer."""
    thickness = calibration.problem.sphere.thickness
    if thickness is None:
        hint = suggested_layer(calibration)
        if hint is None:
            return []
        note = (
            f"the loads ask for an elastic layer about {1e3 * hint.thickness:.2g} mm thick instead of a "
            f"half-space, which would change E by {100 * hint.young_modulus:+.2g} %: measure it and state "
            "thickness_m in [elastic]"
        )
        return [note]
    notes = []
    if scene.elastic is not None and scene.elastic.poisson_ratio < INCOMPRESSIBLE_POISSON_RATIO:
        notes.append(
            f"the law of the layer is that of an incompressible one, and poisson_ratio is "
            f"{scene.elastic.poisson_ratio:g}: the support is felt less than the law says"
        )
    ratio = float(calibration.points["radius_m"].max()) / thickness
    notes.append(f"the contact reaches {ratio:.2g} of the layer's thickness; the law is that of the layer")
    return notes


def _cell_notes(calibration: JkrCalibration, scene: Scene) -> list[str]:
    """What was assumed about the load cell because the scene does not state it."""
    if scene.load.gain_std is not None:
        return []
    gain = calibration.problem.cell.gain_std
    return [f"load cell: gain_std = {gain:g} assumed, which goes into E and w in full; state it in [load]"]
