"""The knobs for the contact models: model, residual of the solver, rings, random patterns."""

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.mechanics.mechanical_effects import estimate_mechanics
from contactimg.effects.output_change import OUTPUTS, relative_change
from contactimg.errors import InputError
from contactimg.models.adhesive import COUPLINGS as ADHESIVE_COUPLINGS
from contactimg.models.greenwood_williamson import RingSolution
from contactimg.models.solution import InteractingSolution
from contactimg.prediction import pattern_sides, refuse_touching_planes, solve_average, solve_scene
from contactimg.surfaces import generate_asperities
from contactimg.tradeoff.average_models import Average, average_change, average_contacts, average_rings
from contactimg.tradeoff.boundary_elements import GRIDS, RESOLUTION, solve_boundary
from contactimg.tradeoff.case import BoundarySolution, Case
from contactimg.tradeoff.knobs import Knob, Setting

Values = NDArray[np.float64]

COMPARED_RINGS = 8
"""Number of rings around the apex over which averages are compared. Chosen by hand."""

LEVELS = {
    "none": "uncoupled",
    "asymptotic": "coupled by point forces",
    "hertz": "coupled by Hertz's displacement alone",
    "full": "fully coupled",
}
"""Level of coupling -> name in the table."""

TOLERANCES = (1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
CONVERGED_RESIDUAL = 1e-13
"""Residual of the reference solution: rounding error."""

RINGS, MANY_RINGS = (10, 20, 50, 100, 200, 400), 800
PATTERNS, MORE_PATTERNS = (1, 2, 4, 8, 16, 32), (64, 128, 256)


def model_knob(case: Case) -> Knob:
    """The contact models: statistical models, levels of coupling, boundary elements."""
    reference = cache(lambda: _in_range(_solve(case, "full")))
    converged = f"the same asperities {LEVELS['full']}"

    def against_best(answer: InteractingSolution) -> float:
        return contact_change(case.output, answer, reference())

    def average_against_best(answer: RingSolution) -> float:
        return _ring_change(case, answer, reference())

    settings = [
        Setting(
            {"gw": "Greenwood-Williamson", "gt": "Greenwood-Tripp"}[model],
            partial(solve_average, case.scene, case.asperities, load=case.load, model=model),
            average_against_best,
            converged,
            message="an average over patterns; its error includes the scatter of this pattern",
        )
        for model in ("gw", "gt")
    ]
    levels = ADHESIVE_COUPLINGS if case.scene.effects.adhesion == "on" else tuple(LEVELS)
    settings += [
        Setting(name, partial(_solve, case, level), against_best, converged)
        for level, name in LEVELS.items()
        if level in levels and level != "full"
    ]
    settings.append(_full_setting(case))
    settings += _boundary_settings(case, reference)
    return Knob("model", "contact model", case.output, case.load, tuple(settings))


def _full_setting(case: Case) -> Setting:
    """Full coupling; its error is the one that the plan of the effects states."""

    def error(_answer: InteractingSolution) -> float:
        stated = estimate_mechanics(case.scene, _asperities(case), load=case.load).model_error.errors
        return max(stated[name] for name in (OUTPUTS if case.output == "all" else (case.output,)))

    return Setting(
        LEVELS["full"],
        lambda: _solve(case, "full"),
        error,
        "solutions of the whole contact problem",
        message="estimated from its own terms, as the plan of the effects states it",
    )


def _stored_reference(truth: BoundarySolution | None) -> str:
    """Name of the stored boundary-element solution in the table."""
    if truth is None:
        return "boundary elements"
    return f"boundary elements, grid 1 um, stored SA+ pattern at {truth.load:g} N"


def _boundary_settings(case: Case, reference: Callable[[], InteractingSolution]) -> Iterator[Setting]:
    """Boundary elements on several grids, and the stored solution."""
    for points in GRIDS if case.fine else GRIDS[:2]:

        def run(points: int = points) -> tuple[Values, Values]:
            return solve_boundary(case, reference(), points=points)

        def error(answer: tuple[Values, Values]) -> float:
            full = reference()
            return relative_change(case.output, without=answer, complete=(full.force, full.radius))

        yield Setting(
            f"boundary elements, {points}²",
            run,
            error,
            f"the same asperities {LEVELS['full']}",
            message="ContactMechanics",
        )
    if case.truth is not None:
        yield Setting(
            "boundary elements, 8192² (stored)",
            lambda: None,
            lambda _: RESOLUTION[case.output],
            "what its grid of 1 um resolves",
            stored_time=case.truth.seconds,
            message=f"{_stored_reference(case.truth)}; time on one core",
        )


def contact_change(output: str, answer: InteractingSolution, reference: InteractingSolution) -> float:
    """Relative error of the output of a solution."""
    pairs = [(solution.force, solution.radius) for solution in (answer, reference)]
    return relative_change(output, without=pairs[0], complete=pairs[1])


def _ring_change(case: Case, rings: RingSolution, reference: InteractingSolution) -> float:
    """Relative error of a statistical solution against the averages of a solution with single contacts."""
    centre = case.scene.need("indenter", "averages").apex
    rows = reference.touching
    if not rows.size:
        raise InputError("there is no contact to average; increase the load")
    farthest = float(np.hypot(reference.x[rows] - centre[0], reference.y[rows] - centre[1]).max())
    edges = np.linspace(0.0, farthest, COMPARED_RINGS + 1)
    return average_change(
        case.output,
        answer=average_rings(rings, edges=edges),
        reference=average_contacts(reference, centre=centre, edges=edges),
    )


def _solve(case: Case, coupling: str, *, tolerance: float | None = None) -> InteractingSolution:
    """Solve the contact problem of the scene at a level of coupling."""
    return solve_scene(case.scene, _asperities(case), load=case.load, coupling=coupling, tolerance=tolerance)


def _asperities(case: Case) -> pd.DataFrame:
    """The asperities of the scene; raise if it has none."""
    if case.asperities is None:
        raise InputError("the scene has no asperities")
    return case.asperities


def _in_range(solution: InteractingSolution) -> InteractingSolution:
    """The solution; raise if most of the planes between the asperities touch."""
    refuse_touching_planes(solution)
    return solution


def solver_knob(case: Case) -> Knob:
    """The residual of the solver, with coupling by point forces."""
    reference = cache(lambda: _in_range(_solve(case, "asymptotic", tolerance=CONVERGED_RESIDUAL)))
    settings = tuple(
        Setting(
            f"residual {tolerance:.0e}",
            partial(_solve, case, "asymptotic", tolerance=tolerance),
            lambda answer: contact_change(case.output, answer, reference()),
            f"the same equations to a residual of {CONVERGED_RESIDUAL:.0e}",
        )
        for tolerance in TOLERANCES
    )
    return Knob("solver", "tolerance of the solver", case.output, case.load, settings)


def ring_knob(case: Case) -> Knob:
    """The number of rings of the Greenwood-Tripp model."""

    def solve(rings: int) -> RingSolution:
        return solve_average(case.scene, case.asperities, load=case.load, model="gt", rings=rings)

    reference = cache(lambda: solve(MANY_RINGS))

    def error(answer: RingSolution) -> float:
        converged = reference()
        edges = np.linspace(0.0, float(converged.r[-1]), COMPARED_RINGS + 1)
        return average_change(
            case.output,
            answer=average_rings(answer, edges=edges),
            reference=average_rings(converged, edges=edges),
        )

    settings = tuple(
        Setting(f"{rings} rings", partial(solve, rings), error, f"{MANY_RINGS} rings") for rings in RINGS
    )
    return Knob("rings", "rings of Greenwood-Tripp", case.output, case.load, settings)


def pattern_knob(case: Case) -> Knob:
    """The number of random patterns that are averaged."""
    counts = (*PATTERNS, *MORE_PATTERNS) if case.fine else PATTERNS
    most = counts[-1]
    averages = cache(lambda: _pattern_averages(case, most))

    def scatter() -> float:
        """Root mean square of the errors of single patterns against the mean of all."""
        patterns = averages()
        mean = Average(
            float(np.mean([one.area for one in patterns])),
            np.mean([one.loads for one in patterns], axis=0),
            float(np.mean([one.mean_radius for one in patterns])),
        )
        errors = [average_change(case.output, answer=one, reference=mean) for one in patterns]
        return float(np.sqrt(np.mean(np.square(errors)) * most / (most - 1)))

    spread = cache(scatter)
    settings = tuple(
        Setting(
            f"{count} pattern" + "s" * (count > 1),
            partial(_pattern_averages, case, count),
            lambda answer: spread() / np.sqrt(len(answer)),
            f"mean of all such patterns (standard error from the scatter of {most})",
        )
        for count in counts
    )
    return Knob("patterns", "patterns of an ensemble", case.output, case.load, settings)


def _pattern_averages(case: Case, count: int) -> list[Average]:
    """Averages over the contacts of each of ``count`` random patterns."""
    return [_pattern_average(case, index) for index in range(count)]


def _pattern_average(case: Case, index: int) -> Average:
    """Averages over the contacts of one random pattern."""
    indenter = case.scene.need("indenter", "averages")
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(index,)))
    solution = solve_scene(case.scene, _draw_pattern(case, rng), load=case.load, coupling="asymptotic")
    edges = np.linspace(0.0, max(_sides(case)) / 2, 4 * COMPARED_RINGS + 1)
    return average_contacts(solution, centre=indenter.apex, edges=edges)


def _sides(case: Case) -> tuple[float, float]:
    """Lengths of the sides of the pattern, m."""
    section = case.scene.need("asperities", "averages")
    if section.generate is not None or case.asperities is None:
        return section.side, section.side
    return pattern_sides(section, case.asperities)


def _draw_pattern(case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Draw a pattern with the generator of the scene, or shift its table and permute the caps."""
    section = case.scene.need("asperities", "a pattern")
    if section.generate is not None:
        return generate_asperities(section.generate, side=section.side, coverage=section.coverage, rng=rng)
    if case.asperities is None:
        raise InputError("the scene has neither a table nor a generator of asperities")
    table = case.asperities.copy()
    for name, side, shift in zip(("x_m", "y_m"), _sides(case), rng.random(2), strict=True):
        low = float(table[name].min() + table[name].max() - side) / 2
        table[name] = low + (table[name] - low + shift * side) % side
    caps = ["height_m", "radius_m"]
    table[caps] = table[caps].to_numpy()[rng.permutation(len(table))]
    return table
