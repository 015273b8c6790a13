"""The table of knobs: the settings of each choice, what they are compared with, and what a scene needs."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import annulus_moments
from contactimg.analysis.radial_profiles import ring_profile
from contactimg.effects.output_change import POWER, chosen_change, relative_change
from contactimg.effects.render_without import measuring
from contactimg.effects.solve_without import estimate_mechanics, solve_scene
from contactimg.errors import InputError, ModelRangeError
from contactimg.frame import Frame
from contactimg.models.adhesive import COUPLINGS as ADHESIVE_COUPLINGS
from contactimg.models.greenwood_williamson import RingSolution
from contactimg.models.solution import InteractingSolution
from contactimg.pose.pairs import MIN_PAIRING_PX, pair_points
from contactimg.prediction import solve_average
from contactimg.render import Rendered, render_contacts, render_reference
from contactimg.scene import Scene
from contactimg.tradeoff.measure import Knob, Setting

Values = NDArray[np.float64]

METHODS = {"threshold": "pixels above the threshold", "disk": "fit of blurred disks"}
"""Method -> name in the table."""

COMPARED_RINGS = 8
"""Number of rings around the apex over which averages are compared. Chosen by hand."""

LEVELS = {
    "none": "uncoupled",
    "asymptotic": "coupled by point forces",
    "hertz": "coupled by Hertz's displacement alone",
    "full": "fully coupled",
}
"""Level of coupling -> name in the table."""


@dataclass(frozen=True, eq=False)
class Average:
    """Averages over all contacts: area (m^2), loads on rings around the apex (N), mean contact radius (m)."""

    area: float
    loads: Values
    mean_radius: float

    def change(self, output: str, reference: "Average") -> float:
        """Relative error against a reference with the same rings.

        ``area``: error of the real contact area. ``force``, ``profile``: sum of ``|dP_k|`` over the rings
        divided by the load. ``radius``: error of the mean contact radius. ``all``: the largest of the three.
        """
        errors = {
            "area": abs(self.area / reference.area - 1),
            "force": float(np.abs(self.loads - reference.loads).sum() / reference.loads.sum()),
            "radius": abs(self.mean_radius / reference.mean_radius - 1),
        }
        return chosen_change(errors, output)


def average_contacts(solution: InteractingSolution, *, centre: tuple[float, float], edges: Values) -> Average:
    """Averages of a solution with single contacts; those beyond the last edge (m) count in the last ring."""
    if not solution.touching.size:
        raise InputError("there is no contact to average; increase the load")
    sums = annulus_moments(solution.contacts(), centre=centre, edges=np.append(edges[:-1], np.inf))
    return Average(solution.area, sums["p"].to_numpy(float), float(sums["a"].sum() / sums["n"].sum()))


def average_rings(rings: RingSolution, *, edges: Values) -> Average:
    """Averages of a statistical solution; what lies beyond the last edge (m) counts in the last ring."""
    edges = np.append(edges[:-1], max(edges[-1], rings.r[-1]))
    table, area = ring_profile(rings.profile(), edges, frame=""), np.pi * np.diff(edges**2)
    loads, count = (area * table[name].to_numpy(float) for name in ("pressure_Pa", "density_per_m2"))
    # where nothing touches there is no mean radius, and none is needed
    return Average(rings.area, loads, float(np.nansum(count * table["mean_radius_m"]) / count.sum()))


@dataclass(frozen=True, eq=False)
class OwnFrame:
    """A measured frame of the scene, whose true contacts are not known; its load (N) is NaN if not known."""

    frame: Frame
    reference: NDArray | None
    load: float


@dataclass(frozen=True, eq=False)
class Case:
    """A scene at a load (N, NaN without one)."""

    scene: Scene
    asperities: pd.DataFrame | None = None
    load: float = math.nan
    measured: OwnFrame | None = None

    @property
    def output(self) -> str:
        """The result that must be accurate."""
        return self.scene.tolerance.output

    def table(self) -> pd.DataFrame:
        """The asperities; raise if the scene has none."""
        if self.asperities is None:
            raise InputError("the scene has no asperities")
        return self.asperities

    def solve(self, coupling: str) -> InteractingSolution:
        """The contacts at a level of coupling."""
        return solve_scene(self.scene, self.table(), load=self.load, coupling=coupling)


def image_settings(case: Case) -> Iterator[Setting]:
    """The methods that measure contacts, on a frame rendered from the scene, else on one of its frames."""
    own = case.measured

    @cache
    def shot() -> tuple[Frame, NDArray | None]:
        if own is not None:
            return own.frame, own.reference
        rng = np.random.default_rng([case.scene.need("simulate", "rendering a frame").seed, 1])
        return rendered().frame, render_reference(case.scene, rng=rng).image

    coupling = "none" if case.scene.effects.coupling == "off" else "asymptotic"
    solution = cache(partial(case.solve, coupling))
    rendered = cache(lambda: _render(case.scene, solution()))

    def run(method: str) -> pd.DataFrame:
        return measuring(case.scene, shot()[0].full_scale)(shot()[0].image, shot()[1], method=method).disks

    fitted = cache(partial(run, "disk"))

    def error(disks: pd.DataFrame) -> float:
        radii = solution().composite_radius[solution().touching]
        return disk_change(case.output, disks, rendered().contacts, shot()[0].shape, radii)

    def against_fit(disks: pd.DataFrame) -> float:
        return disk_change(case.output, disks, fitted(), shot()[0].shape)

    def stated(disks: pd.DataFrame) -> float:
        if not len(disks):
            raise InputError("no contact was found on the frame")
        # of outputs in proportion to powers of independent radii
        a, std = (disks[name].to_numpy(float) for name in ("radius_px", "radius_std_px"))
        parts = {name: n * a ** (n - 1) * std / np.sum(a**n) for name, n in POWER.items()}
        parts["radius"] = std / np.linalg.norm(a)
        return chosen_change({name: float(np.linalg.norm(part)) for name, part in parts.items()}, case.output)

    compared = {
        "threshold": (against_fit, f"{METHODS['disk']} (the truth is not known)"),
        "disk": (stated, "its own stated uncertainty"),
    }
    for method, name in METHODS.items():
        how = (error, "truth of the frame") if own is None else compared[method]
        yield Setting(name, partial(run, method), *how)


def disk_change(
    output: str,
    measured: pd.DataFrame,
    expected: pd.DataFrame,
    shape: tuple[int, int],
    sphere_radius: Values | None = None,
) -> float:
    """Relative error of the output of the disks measured on an image of a shape; forces as ``a^3/R``.

    A disk without a partner is compared with no contact; its radius of curvature is the mean one. Contacts
    that are expected outside the image do not count, found or not.
    """
    if not len(measured):
        raise InputError("no contact was measured")
    found, true = (table[["x_px", "y_px", "radius_px"]].to_numpy(float) for table in (measured, expected))
    curvature = np.ones(len(true)) if sphere_radius is None else sphere_radius
    reach = max(MIN_PAIRING_PX, float(true[:, 2].max(initial=0.0)))
    i, j, distance = pair_points(found[:, :2], true[:, :2], max_distance=reach)
    same = distance <= np.maximum(MIN_PAIRING_PX, true[j, 2])
    i, j = i[same], j[same]
    strangers, radius = np.delete(found[:, 2], i), np.zeros(len(true))
    radius[j] = found[i, 2]
    mean = np.full(strangers.size, np.mean(curvature) if curvature.size else 1.0)
    inside = ((true[:, 1::-1] > -0.5) & (true[:, 1::-1] < np.array(shape) - 0.5)).all(axis=1)
    pairs_of = (radius, strangers), (true[:, 2], 0 * strangers), (curvature, mean)
    radius, complete, curvature = (np.append(part[inside], others) for part, others in pairs_of)
    pairs = [(a**3 / curvature, a) for a in (radius, complete)]
    return relative_change(output, without=pairs[0], complete=pairs[1])


def _render(scene: Scene, solution: InteractingSolution) -> Rendered:
    rng = np.random.default_rng(scene.need("simulate", "rendering a frame").seed)
    radii = solution.composite_radius[solution.touching]
    return render_contacts(solution.contacts("rendered"), scene, rng=rng, sphere_radius=radii)


def model_settings(case: Case) -> Iterator[Setting]:
    """The contact models: statistical models and levels of coupling."""
    levels = ADHESIVE_COUPLINGS if case.scene.effects.adhesion == "on" else tuple(LEVELS)
    best = levels[-1]

    @cache
    def reference() -> InteractingSolution:
        solution = case.solve(best)
        if solution.base_gap.beyond_models:
            raise ModelRangeError(f"{solution.base_gap.sentence}; lower the load")
        return solution

    compared = f"the same asperities {LEVELS[best]}"

    def level_error(answer: InteractingSolution) -> float:
        pairs = [(solution.force, solution.radius) for solution in (answer, reference())]
        return relative_change(case.output, without=pairs[0], complete=pairs[1])

    def average_error(rings: RingSolution) -> float:
        solution, centre = reference(), case.scene.need("indenter", "averages").apex
        rows = solution.touching
        distance = np.hypot(solution.x[rows] - centre[0], solution.y[rows] - centre[1])
        farthest = float(distance.max(initial=0.0))
        edges = np.linspace(0.0, farthest, COMPARED_RINGS + 1)
        expected = average_contacts(solution, centre=centre, edges=edges)
        return average_rings(rings, edges=edges).change(case.output, expected)

    def stated_error(_: InteractingSolution) -> float:
        known = estimate_mechanics(case.scene, case.table(), load=case.load).model_error
        return chosen_change(known.errors, case.output)

    models: dict[Literal["gw", "gt"], str] = {"gw": "Greenwood-Williamson", "gt": "Greenwood-Tripp"}
    said = "an average over patterns; its error includes the scatter of this pattern"
    for model, name in models.items():
        solve = partial(solve_average, case.scene, case.asperities, load=case.load, model=model)
        yield Setting(name, solve, average_error, compared, message=said)
    for level in levels[:-1]:
        yield Setting(LEVELS[level], partial(case.solve, level), level_error, compared)
    truth = "solutions of the whole contact problem"
    said = "estimated from its own terms, as the plan of the effects states it"
    yield Setting(LEVELS[best], partial(case.solve, best), stated_error, truth, message=said)


def lacks(case: Case, kind: str) -> str:
    """A sentence on what a scene lacks for "mechanics", "rendering" or "frames"; empty for nothing."""
    scene = case.scene
    if kind == "frames":
        missing = lacks(case, "rendering") if case.measured is None else ""
        return f"{missing} or frames of its own" if missing else ""
    sections = [*(("camera", "simulate") if kind == "rendering" else ()), "indenter", "elastic", "asperities"]
    missing = ", ".join(f"[{name}]" for name in sections if getattr(scene, name) is None)
    if not missing and case.asperities is None:
        missing = "[asperities] with a file or a generator"
    return f"needs {missing}" if missing else "" if case.load > 0 else "needs a load above 0"


KNOBS: dict[str, tuple[str, Callable[[Case], Iterator[Setting]], str]] = {
    "image": ("measurement of a frame", image_settings, "frames"),
    "model": ("contact model", model_settings, "mechanics"),
}
"""Knob -> what its settings choose, the function that yields them, what a scene must have for it."""


def make_knob(case: Case, name: str) -> Knob:
    """The knob of a name for a case."""
    title, settings, _ = KNOBS[name]
    load = case.load
    if name == "image" and case.measured is not None:
        title, load = f"measurement of {case.measured.frame.name}", case.measured.load
    return Knob(name, title, case.output, load, tuple(settings(case)))


def applicable_knobs(case: Case, names: Sequence[str] = ()) -> tuple[list[Knob], dict[str, str]]:
    """The knobs that apply to a case, and why the others do not.

    Parameters
    ----------
    case : Case
    names : sequence of str
        Names from `KNOBS`; all if empty.

    Raises
    ------
    InputError
        If no knob applies (with the reasons) or a name is unknown.
    """
    unknown = [name for name in names if name not in KNOBS]
    if unknown:
        raise InputError(f"knob must be one of {', '.join(map(repr, KNOBS))}, got {unknown[0]!r}")
    wanted = [name for name in KNOBS if not names or name in names]
    left_out = {name: missing for name in wanted if (missing := lacks(case, KNOBS[name][2]))}
    if len(left_out) == len(wanted):
        by_reason = {why: [k for k in left_out if left_out[k] == why] for why in left_out.values()}
        reasons = (f"{', '.join(names)}: {why}" for why, names in by_reason.items())
        raise InputError(f"nothing to trade accuracy against time on; {'; '.join(reasons)}")
    return [make_knob(case, name) for name in wanted if name not in left_out], left_out
