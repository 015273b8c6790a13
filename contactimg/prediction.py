"""Predictions of the models for a scene: contacts, row of the frames table and profile at each load."""

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq

from contactimg.analysis.annuli import annulus_edges
from contactimg.analysis.radial_profiles import radial_profile
from contactimg.effects.local_law import law_name
from contactimg.effects.output_change import ANNULUS
from contactimg.effects.plan import Plan, make_plan
from contactimg.effects.solve_without import MECHANICAL_EFFECTS, coupling_level, refuse_touching, solve_scene
from contactimg.errors import ConvergenceError, InputError, ModelRangeError
from contactimg.mechanics import hertz
from contactimg.models.base_gap import MAX_TOUCHING_SHARE
from contactimg.models.conditions import ContactConditions
from contactimg.models.convergence import CONVERGED
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.greenwood_williamson import RingSolution, ring_weights, solve_greenwood_williamson
from contactimg.models.height_distributions import GaussianHeights, HeightLaw, SampleHeights, UniformHeights
from contactimg.models.solution import InteractingSolution
from contactimg.models.surroundings import MeanField
from contactimg.scene import Asperities, Scene
from contactimg.surfaces import base_radius
from contactimg.tables import CONTACTS, FRAMES, PROFILE, Status

Coupling = Literal["auto", "none", "asymptotic", "hertz", "full"]
Model = Literal["interacting", "gw", "gt"]
PURPOSE = "a contact model"

COMPARED_MODELS = ("coupled", "uncoupled")
"""Models that measured contacts are compared with: as the plan says, and the same without coupling."""

SIDE_MISMATCH_RATIO = 1.15
"""Ratio of the stated side of a pattern to the span of its table from which one of them is taken for wrong.
Chosen by hand; it only triggers an error."""

MIN_ASPERITIES_FOR_SIDES = 20
"""Number of asperities that fill their rectangle well enough to determine its sides. Chosen by hand;
sensitivity not measured."""


@dataclass(frozen=True)
class Prediction:
    """The solution of a model at one load.

    Attributes
    ----------
    contacts : DataFrame
        Contacts table, lengths in metres; empty for the models that give averages.
    frames : DataFrame
        One row of the frames table.
    profile : DataFrame
        Profile table about the indenter's apex.
    plan : Plan or None
        Which effects were computed and why, if that was planned.
    """

    contacts: pd.DataFrame
    frames: pd.DataFrame
    profile: pd.DataFrame
    plan: Plan | None = None

    @classmethod
    def failed(cls, load: float, reason: str) -> "Prediction":
        """No solution at a load (N): empty tables and a row that says why."""
        frames = _frames(load_name(load), load, status=Status.FAILED, message=reason)
        return cls(CONTACTS.empty(), frames, PROFILE.empty())


def predict_contacts(
    scene: Scene,
    asperities: pd.DataFrame,
    *,
    load: float,
    coupling: Coupling = "auto",
    annulus: float = ANNULUS,
    frame: str = "",
    always_plan: bool = False,
) -> Prediction:
    """Solve the interacting-asperity model for a scene at one load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed. Mechanical effects that ``[effects]`` leaves
        "auto" are switched by the plan for ``[tolerance]`` (`contactimg.effects.plan.make_plan`).
    asperities : DataFrame
        Asperity table.
    load : float, N
    coupling : {"auto", "none", "asymptotic", "hertz", "full"}
        ``"auto"`` follows the plan. Any other level: the paper's model with this coupling; other effects
        only where ``[effects]`` switches them on.
    annulus : float
        Width of the profile's annuli, m.
    frame : str
        Name entered in the tables; default: the load's own name.
    always_plan : bool
        Whether effects are planned, for their expected errors, where ``[effects]`` sets every switch.

    Returns
    -------
    Prediction

    Raises
    ------
    InputError
        If a section is missing, the load is negative, or the effects switched on do not go together.
    ModelRangeError
        If the solution is not unique, or most of the base within the nominal contact touches; less than that
        is said in the message, with its place.
    ConvergenceError
        If the solver stops above its tolerance.
    """
    scene, plan, field, solution = _solve(scene, asperities, load, coupling, always_plan=always_plan)
    name, model = frame or load_name(load), "uncoupled" if solution.coupling == "none" else "coupled"
    contacts = solution.contacts(name)
    radius, spheres = contacts["radius_m"].to_numpy(float), solution.composite_radius[solution.touching]
    modulus = scene.need("elastic", PURPOSE).contact_modulus
    contacts["force_hertz_N"] = hertz.load(radius, sphere_radius=spheres, contact_modulus=modulus)
    row = {
        "n_contacts": len(contacts),
        "area_m2": float(contacts["area_m2"].sum()),
        "force_sum_N": float(contacts["force_N"].sum()),
        "force_hertz_sum_N": contacts["force_hertz_N"].sum(),
        "indentation_m": solution.indentation + (0.0 if field is None else field.sinking(asperities)),
        "min_gap_m": solution.base_gap.least,
        "law": law_name(scene),
    }
    border = _around_the_table(scene, asperities, solution, field, load)
    unproven = "" if solution.status == CONVERGED else solution.status
    doubtful = unproven or solution.validity.planes_touch or "runs off the table" in border
    said = [unproven, *solution.validity.messages(), border, *([] if plan is None else plan.messages)]
    status = Status.APPROXIMATE if doubtful else Status.OK
    row |= {"status": status, "message": "; ".join(filter(None, said))}
    centre = scene.need("indenter", "a profile").apex
    edges = annulus_edges(contacts, centre=centre, width=annulus)
    profile = radial_profile(contacts, centre=centre, edges=edges, frame=name, model=model)
    return Prediction(contacts, _frames(name, load, **row), profile, plan)


def _solve(
    scene: Scene, asperities: pd.DataFrame, load: float, coupling: Coupling, *, always_plan: bool = False
) -> tuple[Scene, Plan | None, MeanField | None, InteractingSolution]:
    """The scene with all mechanical switches set, its plan and mean field if any, and the solution.

    Arguments and errors are those of `predict_contacts`.
    """
    plan, auto = None, [name for name in MECHANICAL_EFFECTS if getattr(scene.effects, name) == "auto"]
    if coupling != "auto":
        switches = dict.fromkeys(auto, "off") | {"coupling": "off" if coupling == "none" else "on"}
        scene = scene.with_effects(switches | {"full_coupling": "on" if coupling == "full" else "off"})
    if always_plan or (auto and coupling == "auto"):
        plan = make_mechanical_plan(scene, asperities, load=load)
        scene = plan.apply(scene)
    level = coupling if coupling == "hertz" else coupling_level(scene.effects)
    field = field_around(scene, asperities, load, coupled=level != "none")
    solution = solve_scene(scene, asperities, load=load, coupling=level, surroundings=field)
    refuse_touching(solution, solution.load)
    return scene, plan, field, solution


def make_mechanical_plan(scene: Scene, asperities: pd.DataFrame, *, load: float) -> Plan:
    """The plan of a scene without optics and sensor; see `contactimg.effects.plan.make_plan`."""
    return make_plan(scene.model_copy(update={"simulate": None}), asperities, load=load)


def scene_of_model(scene: Scene, model: str) -> Scene:
    """The scene of one of `COMPARED_MODELS`: without coupling for ``"uncoupled"``."""
    return scene if model == "coupled" else scene.with_effects({"coupling": "off", "full_coupling": "off"})


def field_around(scene: Scene, asperities: pd.DataFrame, load: float, *, coupled: bool) -> MeanField | None:
    """The mean field around a table, if ``[asperities] surroundings`` asks for it."""
    if scene.asperities is None or scene.asperities.surroundings == "none":
        return None
    refused = _without_mean_field(scene, asperities)
    if scene.effects.adhesion == "on":
        refused = 'bears a share of a load without adhesion; state [effects] adhesion = "off"'
    if refused:
        raise InputError(f'[asperities] surroundings = "mean_field" {refused}, or leave it out')
    return _mean_field(scene, asperities, load, coupled=coupled) if load > 0 else None


def _without_mean_field(scene: Scene, asperities: pd.DataFrame) -> str:
    """Why a table has no mean field; empty if it has."""
    if scene.indenter is None or not np.isfinite(scene.indenter.radius):
        return "takes a lens of finite radius; state one"
    if len(asperities) < MIN_ASPERITIES_FOR_SIDES or not _spans(asperities).min() > 0:
        return f"needs at least {MIN_ASPERITIES_FOR_SIDES} asperities spread over a rectangle; take more"
    return ""


def _spans(asperities: pd.DataFrame) -> NDArray[np.float64]:
    """Sides in x and in y (m) of the box of the places."""
    return np.ptp(asperities[["x_m", "y_m"]].to_numpy(float), axis=0)


def _mean_field(scene: Scene, asperities: pd.DataFrame, load: float, *, coupled: bool) -> MeanField:
    """The mean field of a table at a load."""
    indenter, elastic = scene.need("indenter", PURPOSE), scene.need("elastic", PURPOSE)
    layer = elastic.thickness if scene.effects.layer == "on" and elastic.thickness else np.inf
    conditions = ContactConditions(
        indenter.radius, elastic.contact_modulus, indenter.apex, layer, load, None, elastic.poisson_ratio
    )
    rectangle = table_rectangle(scene.asperities or Asperities(), asperities)
    return MeanField(asperities, rectangle, conditions, coupled)


def table_rectangle(section: Asperities, asperities: pd.DataFrame) -> NDArray[np.float64]:
    """Limits in x and in y (m) of what a table describes: the generated square, or the caps' discs."""
    if section.generate is not None:
        return np.array([[0.0, section.side], [0.0, section.side]])
    base = base_radius(asperities["height_m"], asperities["radius_m"])
    places = asperities[["x_m", "y_m"]].to_numpy(float).T
    return np.stack([(places - base).min(axis=1), (places + base).max(axis=1)], axis=1)


def _around_the_table(
    scene: Scene, table: pd.DataFrame, solution: InteractingSolution, field: MeanField | None, load: float
) -> str:
    """A sentence on what lies around the table; empty where the contact region ends inside it."""
    if field is not None:
        carried = f"{field.load:.4g} N on {field.area * 1e6:.4g} mm2"
        return f"around the table a mean field carries {carried}, which are not in the sums"
    if not load > 0 or _without_mean_field(scene, table):
        return ""
    outside, rows = _mean_field(scene, table, load, coupled=solution.coupling != "none"), solution.touching
    rim = outside.rim_share(solution.x[rows], solution.y[rows], solution.force[rows])
    (low, high), apex = outside.rectangle.T, outside.conditions.apex
    if (rim == 0 and np.all((apex > low) & (apex < high))) or outside.share < 2e-3:  # too little to be said
        return ""
    return (
        f"the contact region runs off the table: {100 * rim:.3g} % of the load is borne within one mean "
        f"spacing of its rim, and a mean field outside would carry {100 * outside.share:.3g} % of the load; "
        'take a larger table, or [asperities] surroundings = "mean_field"'
    )


def predict_average(
    scene: Scene, asperities: pd.DataFrame | None, *, load: float, model: Literal["gw", "gt"]
) -> Prediction:
    """Solve a statistical model for a scene at one load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]``, ``[elastic]`` and ``[asperities]`` are needed.
    asperities : DataFrame or None
        Asperity table; what ``[asperities]`` does not state of density, radius and heights is derived from
        it, the density with `asperity_density`.
    load : float
        N, not negative.
    model : {"gw", "gt"}
        Greenwood-Williamson on the rings of an undeformed sphere, or Greenwood-Tripp.

    Returns
    -------
    Prediction
        With an empty contacts table.

    Raises
    ------
    InputError
        If something the model needs is neither stated nor derivable, or an argument breaks its rule.
    ModelRangeError
        If contacts would be wider than the asperities.
    ConvergenceError
        If the rings do not converge.
    """
    name = load_name(load)
    if load == 0:
        nothing = _frames(name, load, area_m2=0.0, force_sum_N=0.0, indentation_m=0.0)
        return Prediction(CONTACTS.empty(), nothing, PROFILE.empty())
    rings = solve_average(scene, asperities, load=load, model=model)
    profile = rings.profile(name)
    widest = profile["mean_radius_m"].max()
    radius = _mean_radius(scene.need("asperities", PURPOSE), asperities)
    if widest > radius:
        raise ModelRangeError(
            f"at {load:g} N the contacts would have a mean radius of {widest * 1e6:.3g} um on asperities of "
            f"{radius * 1e6:.3g} um, outside every asperity model; lower the load"
        )
    if rings.touching_share > MAX_TOUCHING_SHARE:
        raise ModelRangeError(f"at {load:g} N {rings.limits()[-1]}; lower the load")
    remarks, count = [*rings.limits()], float(ring_weights(rings.r) @ rings.density)
    if count < 10:  # theory: a single pattern scatters about the average by 1/sqrt(n), here by 32 %
        remarks.append(
            f"an average over random patterns in which only about {count:.2g} asperities touch: a single "
            f"pattern scatters about it by {100 / np.sqrt(count):.0f} % or more"
        )
    frames = _frames(
        name,
        load,
        status=Status.APPROXIMATE if rings.base_gap < 0 else Status.OK,
        area_m2=float(rings.area),
        force_sum_N=float(rings.load),
        indentation_m=rings.indentation,
        min_gap_m=rings.base_gap,
        law="hertz",
        message="; ".join(remarks),
    )
    return Prediction(CONTACTS.empty(), frames, profile)


def solve_average(
    scene: Scene, asperities: pd.DataFrame | None, *, load: float, model: Literal["gw", "gt"]
) -> RingSolution:
    """Solve a statistical model for a scene: the rings behind `predict_average`, with its arguments."""
    indenter, elastic = scene.need("indenter", PURPOSE), scene.need("elastic", PURPOSE)
    section: Asperities = scene.need("asperities", "a statistical model")
    if not np.isfinite(indenter.radius):
        raise InputError(f'model "{model}" takes a lens of finite radius, and [indenter] radius_m is "flat"')
    radius = _mean_radius(section, asperities)
    solve = solve_greenwood_williamson if model == "gw" else solve_greenwood_tripp
    return solve(
        _height_law(section, asperities),
        density=asperity_density(section, asperities),
        radius=radius * indenter.radius / (radius + indenter.radius),
        indenter_radius=indenter.radius,
        contact_modulus=elastic.contact_modulus,
        load=load,
    )


def _frames(name: str, load: float, **row: Any) -> pd.DataFrame:
    """The frames table of a load."""
    return FRAMES.conform(pd.DataFrame([{"frame": name, "status": Status.OK, "load_N": load} | row]))


def _table(asperities: pd.DataFrame | None, wanted: str) -> pd.DataFrame:
    """The table that a missing statistical parameter is derived from."""
    if asperities is None or asperities.empty:
        raise InputError(f"a statistical model needs {wanted} in [asperities], or a table to derive it from")
    return asperities


def _mean_radius(section: Asperities, asperities: pd.DataFrame | None) -> float:
    """Radius of curvature of the asperities, m."""
    if section.radius is not None:
        return section.radius
    return float(_table(asperities, "radius_m")["radius_m"].mean())


def asperity_density(section: Asperities, asperities: pd.DataFrame | None) -> float:
    """Asperities per unit area (1/m^2): as the section states it, or those of the table on its rectangle.

    The rectangle has the sides ``side_m`` where that is stated or the pattern generated, else those that the
    caps of the table span.

    Raises
    ------
    InputError
        If neither is there, or the table has too few asperities to determine the sides, or contradicts
        ``side_m``.
    """
    if section.density is not None:
        return section.density
    table = _table(asperities, "density_per_m2")
    spans, many = _spans(table), len(table) >= MIN_ASPERITIES_FOR_SIDES
    sides = np.ptp(table_rectangle(Asperities(), table), axis=1)
    if section.generate is None and "side" not in section.model_fields_set:
        if not (many and spans.min() > 0):
            cure = "state side_m or density_per_m2 in [asperities]"
            raise InputError(f"{len(table)} asperities do not tell the area that they stand for; {cure}")
        return len(table) / float(np.prod(sides))
    too_small = many and sides.max() < section.side / SIDE_MISMATCH_RATIO
    if too_small or spans.max() > SIDE_MISMATCH_RATIO * section.side:
        raise InputError(
            f"[asperities] side_m is {section.side:g} m but the table spans {spans[0]:.3g} x "
            f"{spans[1]:.3g} m; correct it, leave it out, or state density_per_m2"
        )
    return len(table) / section.side**2


def _height_law(section: Asperities, asperities: pd.DataFrame | None) -> HeightLaw:
    """The stated height law, or the heights of the table."""
    if section.height_law is None:
        return SampleHeights(_table(asperities, "height_law")["height_m"].to_numpy(float))
    uniform = section.height_law == "uniform"
    names = ("height_min", "height_max") if uniform else ("height_mean", "height_std")
    first, second = (getattr(section, name) for name in names)
    if first is None or second is None:
        raise InputError(
            f'[asperities] height_law = "{section.height_law}" needs {names[0]}_m and {names[1]}_m; add them'
        )
    return UniformHeights(first, second) if uniform else GaussianHeights(first, second)


TOUCHING_ACCURACY = 1e-3
"""Relative accuracy of the load at which planes touch. Chosen: far below the scatter between patterns."""


def find_touching_load(
    scene: Scene,
    asperities: pd.DataFrame | None,
    *,
    model: Model = "interacting",
    coupling: Coupling = "auto",
) -> float:
    """The load at which the base planes of lens and rubber touch first, N.

    Parameters
    ----------
    scene, asperities
        As for `predict_contacts`; for ``"gw"`` and ``"gt"`` as for `predict_average`.
    model : {"interacting", "gw", "gt"}
    coupling : str
        As for `predict_contacts`.

    Returns
    -------
    float
        To a relative `TOUCHING_ACCURACY`; 0 if the planes touch before the asperities do.

    Raises
    ------
    ModelRangeError
        If the model ends before the planes touch, with the smallest gap at the last load that it describes.
    """
    reasons: dict[float, str] = {}
    table = pd.DataFrame() if asperities is None else asperities
    if model == "interacting" and table.empty:
        raise InputError("the interacting model needs a table of asperities")

    @cache
    def gap(load: float) -> float:
        try:
            if model == "interacting":
                found = _solve(scene, table, load, coupling)[-1].base_gap.least
            else:
                row = predict_average(scene, asperities, load=load, model=model).frames
                found = float(row["min_gap_m"].iloc[0])
        except (ModelRangeError, ConvergenceError) as error:
            reasons[load] = str(error)
            return -np.inf
        if np.isnan(found):
            raise InputError("the asperities cover all of the base: no planes are left that could touch")
        return found

    size = _mean_radius(scene.asperities or Asperities(), table)
    first = low = high = 1e-2 * scene.need("elastic", PURPOSE).contact_modulus * size**2
    while gap(high) > 0 and high < 1e24 * first:  # beyond nobody looks
        low, high = high, 4 * high
    while gap(low) <= 0 and low > 1e-9 * first:  # below the planes touch before the asperities do
        low, high = low / 4, low
    while gap(low) > 0 and high in reasons and high > (1 + TOUCHING_ACCURACY) * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if gap(middle) > 0 else (low, middle)
    if gap(low) > 0 and high not in reasons:
        return float(brentq(gap, low, high, rtol=TOUCHING_ACCURACY))
    if low not in reasons and gap(low) <= 0:
        return 0.0
    raise ModelRangeError(
        f"the model ends before the planes touch: at {low:.4g} N the smallest gap is {gap(low) * 1e6:.3g} "
        f"um; beyond, {reasons.get(high) or reasons.get(low)}"
    )


def load_name(load: float) -> str:
    """One unique name a load, from its shortest exact decimal form."""
    return f"load_{float(load)!r}N"


def hertz_circle(scene: Scene, load: float) -> tuple[float, float, float] | None:
    """Apparent contact ``(x, y, radius)`` of the smooth sphere at a load (m), if the scene has one."""
    if scene.indenter is None or scene.elastic is None or not 0 <= load < np.inf > scene.indenter.radius:
        return None
    body = {"sphere_radius": scene.indenter.radius, "contact_modulus": scene.elastic.contact_modulus}
    return *scene.indenter.apex, float(hertz.radius(load, **body))
