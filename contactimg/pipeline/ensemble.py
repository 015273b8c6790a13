"""Predictions averaged over many random patterns, which are resumed and added up as they come."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import MOMENTS, annulus_moments
from contactimg.analysis.radial_profiles import average_profile
from contactimg.effects.local_law import law_name
from contactimg.effects.plan import Plan
from contactimg.engine.calls import in_parallel
from contactimg.errors import ContactimgError, InputError
from contactimg.files import PartStore
from contactimg.models.load_spring import LoadSpring
from contactimg.models.proof import CONVERGED
from contactimg.pipeline.inputs import (
    generated_asperities,
    loads_before,
    need_asperities,
    refuse_repeated,
    solver_tolerance,
)
from contactimg.prediction import (
    Coupling,
    Prediction,
    Prescribed,
    load_name,
    make_mechanical_plan,
    scene_level,
    solve_scene,
    surrounding_field,
    with_coupling,
    with_memory,
)
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE, Status

Values = NDArray[np.float64]

GROUPS = 32
"""Groups of patterns whose scatter gives the uncertainty of the profile. Theory: 32 know a standard deviation
to 1/sqrt(2 31) = 13 %."""

SCALARS = ("area", "area^2", "force", "contacts", "indentation", "load", "gap", "touching", "approximate")
"""Sums over patterns, SI units; the last two are counts of patterns."""


PatternSums = tuple[Values, Values]
"""What one pattern adds at one load: `SCALARS`, and of each annulus `contactimg.analysis.annuli.MOMENTS`."""


@dataclass(frozen=True)
class Ensemble:
    """What the patterns of an ensemble have in common.

    Parameters
    ----------
    scenes : tuple of Scene
        One a load, with the effects switched; ``[asperities]`` generates the patterns.
    loads : tuple of float, N, or of LoadSpring
    histories : tuple of tuple
        The loads that came before each.
    coupling : str
        "hertz", or "auto" for what the effects say.
    edges : tuple of float, m
        Of annuli around the apex.
    tolerance : float or None
        Of the solver.
    """

    scenes: tuple[Scene, ...]
    loads: tuple[Prescribed, ...]
    histories: tuple[tuple[Prescribed, ...], ...]
    coupling: str
    edges: tuple[float, ...]
    tolerance: float | None

    def solve(self, index: int) -> list[PatternSums | str]:
        """Pattern ``index`` at each load, or why it has no solution; depends on the seed and on it alone."""
        asperities = generated_asperities(self.scenes[0], index)
        cases = zip(self.scenes, self.loads, self.histories, strict=True)
        return [self._solve_load(asperities, *case) for case in cases]

    def _solve_load(
        self, asperities: pd.DataFrame, scene: Scene, load: Prescribed, history: Sequence[Prescribed]
    ) -> PatternSums | str:
        """A pattern at one load."""
        level = scene_level(scene, self.coupling)
        try:
            field = surrounding_field(scene, asperities, load, coupled=level != "none")
            found = solve_scene(
                scene,
                asperities,
                load=load,
                coupling=level,
                tolerance=self.tolerance,
                history=history,
                surroundings=field,
            )
        except ContactimgError as error:
            return str(error)
        if found.base_gap.beyond_models:
            return found.base_gap.sentence
        values = {"x_m": found.x, "y_m": found.y, "radius_m": found.radius, "force_N": found.force}
        contacts = pd.DataFrame({name: value[found.touching] for name, value in values.items()})
        centre = scene.need("indenter", "an ensemble").apex
        moments = annulus_moments(contacts, centre=centre, edges=self.edges)
        area = float(np.pi * np.sum(contacts["radius_m"].to_numpy() ** 2))
        force, count = float(contacts["force_N"].sum()), float(len(contacts))
        gap, converged = found.base_gap.least, found.status == CONVERGED
        doubts = float(gap < 0), float(not converged)
        scalars = [area, area**2, force, count, found.indentation, found.load, gap, *doubts]
        return np.array(scalars), moments[list(MOMENTS)].to_numpy(float)


@dataclass(eq=False)
class LoadSums:
    """The sums over patterns at one load, and of annuli over groups of them."""

    patterns: int = 0
    scalars: Values = field(default_factory=lambda: np.zeros(len(SCALARS)))
    groups: dict[int, Values] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def add(self, index: int, found: PatternSums | str) -> None:
        """Add a pattern."""
        if isinstance(found, str):
            self.failures.append(found)
            return
        (scalars, moments), group = found, index % GROUPS
        self.patterns += 1
        self.scalars = self.scalars + scalars
        self.groups[group] = self.groups[group] + moments if group in self.groups else moments


def predict_ensemble(
    scene: Scene,
    loads: Sequence[Prescribed],
    *,
    patterns: int,
    coupling: Coupling,
    annulus: float,
    relative: float | None = None,
    workers: int | None = 1,
    store: PartStore | None = None,
    advance: Callable[[], None] | None = None,
) -> list[Prediction]:
    """Predict the averages over random patterns at each load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed, and ``[asperities]`` with ``generate``. Its own
        pattern decides which effects are computed.
    loads : sequence of float, N, or of LoadSpring
        Each once.
    patterns : int
        Their number. Pattern ``k`` depends only on ``[asperities] seed`` and on ``k``.
    coupling : str
        As for `contactimg.prediction.predict_contacts`.
    annulus : float
        Width of the annuli around ``[indenter] apex_m``, m.
    relative : float, optional
        Tolerance of the output, as for `contactimg.pipeline.predict.predict_loads`.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`.
    store : PartStore, optional
        Patterns that it holds are taken from it, the others are added.
    advance : callable, optional
        Called once a pattern, in order.

    Returns
    -------
    list of Prediction
        In order, without contacts. Uncertainties are standard errors of the mean.

    Raises
    ------
    InputError
        If the scene generates no patterns.
    """
    section = scene.asperities
    if section is None or section.generate is None:
        raise InputError("an ensemble needs random patterns: state generate in [asperities]")
    refuse_repeated(loads)
    if patterns < 1:
        raise InputError(f"an ensemble needs one pattern at least, got {patterns}")
    typical, scene = need_asperities(scene, "an ensemble"), with_coupling(scene, coupling)
    planned: dict[int, tuple[Scene, Plan]] = {}
    failed: dict[int, ContactimgError] = {}
    histories = [loads_before(scene, load, loads) for load in loads]
    for k, load in enumerate(loads):
        remembering = with_memory(scene, histories[k])
        try:
            plan = make_mechanical_plan(remembering, typical, load=load)
            planned[k] = plan.apply(remembering), plan
        except ContactimgError as error:
            failed[k] = error
    if not planned:
        raise failed[0]
    ensemble = Ensemble(
        tuple(one for one, _ in planned.values()),
        tuple(loads[k] for k in planned),
        tuple(histories[k] for k in planned),
        "hertz" if coupling == "hertz" else "auto",
        _edges(scene, section.side, annulus),
        solver_tolerance(relative),
    )
    sums = [LoadSums() for _ in planned]
    for index, found in enumerate(_solved(ensemble, patterns, workers=workers, store=store)):
        for one, part in zip(sums, found, strict=True):
            one.add(index, part)
        if advance is not None:
            advance()
    found_at = {
        k: _average(one, loads[k], *planned[k], ensemble.edges) for k, one in zip(planned, sums, strict=True)
    }
    return [
        found_at[k] if k in planned else Prediction.failed(load, f"no plan of the effects: {failed[k]}")
        for k, load in enumerate(loads)
    ]


def _edges(scene: Scene, side: float, width: float) -> tuple[float, ...]:
    """Edges of annuli around the apex that hold a square pattern, m."""
    if not (np.isfinite(width) and width > 0):
        raise InputError(f"the width of an annulus must be positive, got {width!r} m")
    apex = np.array(scene.need("indenter", "an ensemble").apex)
    farthest = float(np.hypot(*np.maximum(np.abs(apex), np.abs(side - apex))))
    return tuple((width * np.arange(int(farthest // width) + 2)).tolist())


def _solved(
    ensemble: Ensemble, patterns: int, *, workers: int | None, store: PartStore | None
) -> Iterator[list[PatternSums | str]]:
    """The patterns in order, a few in memory at a time."""
    jobs = [(k,) for k in range(patterns)]
    lost = partial(_lost, len(ensemble.loads))
    if store is None:
        return in_parallel(ensemble.solve, jobs, count=patterns, workers=workers, lost=lost)
    common = store.common(["ensemble", ensemble])
    names = [store.name(common, None, k) for k in range(patterns)]
    said = "%s of %s patterns were done by a run that was ended; the others are solved"
    return store.results(ensemble.solve, jobs, names, workers=workers, lost=lost, said=said)


def _lost(loads: int, error: Exception, _index: int) -> list[PatternSums | str]:
    """The failure of a pattern whose workers were ended."""
    return [f"its solution {error}"] * loads


def _average(
    sums: LoadSums, load: Prescribed, scene: Scene, plan: Plan, edges: tuple[float, ...]
) -> Prediction:
    """The averages at a load."""
    if not sums.patterns:
        return Prediction.failed(load, f"no pattern has a solution; the first: {sums.failures[0]}")
    name, n = load_name(load), sums.patterns
    area, square, force, contacts, indentation, borne, gap, _, _ = (sums.scalars / n).tolist()
    touching, approximate = (round(count) for count in sums.scalars[-2:])
    spread = np.sqrt(max(square - area**2, 0.0) / (n - 1)) if n > 1 else np.nan
    notes = [f"average over {n:,} random patterns, {contacts:.4g} contacts each", *plan.messages]
    if touching:
        notes.append(f"in {touching:,} of them the planes touch; the load that they carry is left out")
    if approximate:
        notes.append(f"in {approximate:,} of them the solution is approximate only")
    if sums.failures:
        notes.append(f"{len(sums.failures):,} patterns without a solution are left out: {sums.failures[0]}")
    row = {
        "frame": name,
        "status": Status.APPROXIMATE if sums.failures or approximate or touching else Status.OK,
        "load_N": borne if isinstance(load, LoadSpring) else load,
        "area_m2": area,
        "area_std_m2": spread,
        "force_sum_N": force,
        "indentation_m": indentation,
        "min_gap_m": gap,
        "law": law_name(scene),
        "message": "; ".join(notes),
    }
    coupled = "uncoupled" if scene_level(scene, "auto") == "none" else "coupled"
    ends = {"inner": edges[:-1], "outer": edges[1:]}
    groups = [
        pd.DataFrame(ends | dict(zip(MOMENTS, moments.T, strict=True))) for moments in sums.groups.values()
    ]
    profile = average_profile(groups, frame=name, model=coupled)
    last = int(np.flatnonzero(profile["density_per_m2"].to_numpy() > 0).max(initial=0))
    frames = FRAMES.conform(pd.DataFrame([row]))
    return Prediction(CONTACTS.empty(), frames, PROFILE.conform(profile.iloc[: last + 1]), plan)
