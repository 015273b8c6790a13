"""Analyse the runs of one or several places together, and the models of these places in the same way."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis import radial_profiles
from contactimg.analysis.annuli import annulus_edges, sum_moments
from contactimg.analysis.area_power_law import area_by_load, fit_area_law, frame_areas
from contactimg.analysis.contacts_against_pressure import QUANTITIES, fit_contact_law, pressure_points
from contactimg.analysis.estimates import COVERAGE, Estimate
from contactimg.analysis.friction import ShearStress, compare_stress, fit_shear_stress, stress_by_velocity
from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell
from contactimg.analysis.power_laws import BrokenLaw, PowerLaw, fit_power_law
from contactimg.errors import InputError
from contactimg.files import Run
from contactimg.pipeline.analyse.places import (
    Place,
    annuli_of,
    differences,
    fit_or_note,
    grouped,
    predict_places,
    usable_frames,
)
from contactimg.pipeline.analyse.sheared import Sheared, analyse_shear
from contactimg.pipeline.measured_series import cut_frames, doubt_match
from contactimg.pipeline.results import frame_notes, reservations, write_results
from contactimg.plots import plot_areas, plot_friction, plot_pressure_law, plot_profile, plot_sheared_areas
from contactimg.prediction import COMPARED_MODELS, asperity_density, predict_average
from contactimg.tables import AREA, FRICTION, NORMALISED, PRESSURE_LAW, PROFILE, RESULTS, RUN_MODELS

logger = logging.getLogger(__name__)

Seen = dict[str, list[Place]]
"""Name of a model, or "measured" or "predicted" for the runs themselves -> what it says of the places."""


@dataclass(frozen=True)
class AnalysisOptions:
    """Settings of an analysis.

    Parameters
    ----------
    annulus : float, m
        Width of an annulus.
    load_tolerance : float
        Largest relative difference of loads that are averaged as one.
    load_relative_std, load_std : float
        Standard uncertainty of a load, relative and in N; the two add in quadrature.
    friction_std : float, N
        Standard uncertainty of a friction force.
    min_radius_px : float
        Radius of the smallest contacts, measured or predicted, that count in annuli: contacts that the camera
        cannot resolve must not count for the models only. Areas A(P) include all contacts.
    models : bool
        Whether the coupled, uncoupled and Greenwood-Tripp models are solved too.
    smooth : Place or None
        Run with a smooth lens, whose shear stress is the one to compare with.
    """

    annulus: float = 2.5e-4
    load_tolerance: float = 0.05
    load_relative_std: float = 0.0
    load_std: float = 0.0
    friction_std: float = 0.0
    min_radius_px: float = 1.0
    models: bool = True
    smooth: Place | None = None


@dataclass(frozen=True, eq=False)
class Analysis:
    """The result of an analysis of all places.

    Parameters
    ----------
    area, profile, normalised, pressure_law, friction : DataFrame
        Tables of `contactimg.tables`; rows of the runs (`contactimg.tables.RUN_MODELS`: ``measured``, or
        ``predicted`` if they are those of `predict`) and of the models side by side.
    area_laws : dict
        Model -> exponent of A(P).
    contact_laws : dict
        (Quantity, model) -> the two power laws against the local pressure.
    shear_stress : ShearStress or None
    smooth_stress : Estimate or None, Pa
        That of a smooth contact, to compare with.
    velocity_law : PowerLaw or None
        Shear stress against sliding velocity, if the loads state two velocities or more.
    sheared : Sheared
        Contacts by asperity, and their laws under a tangential load.
    notes : tuple of str
        What was left out, and why.
    """

    area: pd.DataFrame
    profile: pd.DataFrame
    normalised: pd.DataFrame
    pressure_law: pd.DataFrame
    friction: pd.DataFrame
    area_laws: dict[str, PowerLaw]
    contact_laws: dict[tuple[str, str], BrokenLaw]
    shear_stress: ShearStress | None
    smooth_stress: Estimate | None
    velocity_law: PowerLaw | None
    sheared: Sheared
    notes: tuple[str, ...]


def analyse_places(places: Sequence[Place], options: AnalysisOptions) -> Analysis:
    """Analyse the runs of one or several places of a sample.

    Parameters
    ----------
    places : sequence of Place
        From `open_place`, each folder once: one surface under one lens. Where they differ in lens, rubber or
        asperities a warning says so.
    options : AnalysisOptions

    Returns
    -------
    Analysis

    Raises
    ------
    InputError
        If a place is given twice, if some places are measured and others predicted, if no place has a frame
        with a load above zero and an area, or if the smooth run has no friction force beside an area.
    """
    own, smooth = _run_model(places), options.smooth
    smooth_stress = None if smooth is None else _shear_stress(_friction_table([smooth]), options).stress
    notes = [note for place in places for note in _notes_on_frames(place)]
    friction, density = _friction_table(places), _density(places[0])
    seen = {own: grouped(places, tolerance=options.load_tolerance)}
    lacking = [f"{place.name} lacks {' and '.join(parts)}" for place in places if (parts := _lacking(place))]
    if options.models and lacking:
        notes.append(f"no model curves: {'; '.join(lacking)}")
    elif options.models:
        for model in COMPARED_MODELS:
            seen[model], left_out = predict_places(seen[own], model)
            notes += left_out
        for place, predicted in zip(places, seen["coupled"], strict=True) if own == "measured" else ():
            _doubt_match(place, predicted, options.min_radius_px)
    groups = pd.concat([place.frames for place in seen[own]]).groupby("group")[["group_name", "group_load"]]
    loads = groups.first().itertuples(index=False)
    averages = [_average_load(name, load, seen, options, notes) for name, load in loads]
    sheared = analyse_shear(places, notes, load_tolerance=options.load_tolerance)
    stress = None if friction.empty else fit_or_note(notes, "friction", _shear_stress, friction, options)
    points = [_points(average, density) for average in averages]
    area, area_laws = _areas(places, seen, averages, options, notes)
    return Analysis(
        area=area,
        profile=PROFILE.joined(average.profile for average in averages),
        normalised=NORMALISED.joined(average.normalised for average in averages),
        pressure_law=PRESSURE_LAW.joined(points),
        friction=friction,
        area_laws=area_laws,
        contact_laws=_local_laws(averages, own, notes),
        shear_stress=stress,
        smooth_stress=smooth_stress,
        velocity_law=_velocity_law(friction, options, notes),
        sheared=sheared,
        notes=tuple(dict.fromkeys(notes)),
    )


def _run_model(places: Sequence[Place]) -> str:
    """The name in tables of the contacts of the runs: "measured" or "predicted", if they go together."""
    for one, other in combinations(places, 2):
        if Path(one.name).resolve() == Path(other.name).resolve() or one.images & other.images:
            raise InputError(f"{one.name} and {other.name} are runs of the same frames; give one of them")
    predicted = {place.predicted for place in places}
    if len(predicted) > 1:
        raise InputError("measured and predicted runs are given together; analyse them apart")
    for difference in differences(places):
        logger.warning(difference)
    return "predicted" if predicted == {True} else "measured"


def _doubt_match(place: Place, predicted: Place, min_radius_px: float) -> None:
    """Stop where fewer than half of the contacts of a place are on the asperities of the predicted ones."""
    if place.pose is None or place.asperities is None:
        return
    smallest = min_radius_px * place.pose.pixel_size
    ours, theirs = (
        table.loc[table["radius_m"] >= smallest, ["frame", "asperity"]]
        for table in (place.contacts, predicted.contacts)
    )
    ours = ours[ours["frame"].isin(predicted.frames["frame"])]
    counts = {"measured": len(ours), "predicted": len(theirs), "matched": len(ours.dropna().merge(theirs))}
    run = Run(place.scene, place.contacts, place.frames)
    doubt_match(run, place.pose, place.asperities, place.name, **counts)


def _lacking(place: Place) -> list[str]:
    """Name what the models of a place need and do not have."""
    scene, file = place.scene, place.scene.asperities and place.scene.asperities.file
    table = f"the table {Path(scene.folder) / file}, which cannot be read" if file else "the asperities"
    needed = {"the lens": scene.indenter, "the rubber": scene.elastic, table: place.asperities}
    return [name for name, value in needed.items() if value is None]


def _notes_on_frames(place: Place) -> list[str]:
    """The frames of a place that cannot be used, and why, and what to be wary of in the others."""
    used = usable_frames(place)
    unused = place.frames[~place.frames["frame"].isin(used["frame"])]
    notes = [f"{place.name}, {note}" for note in reservations(used)]
    if place.pose is not None:
        cut = cut_frames(place.contacts[place.contacts["frame"].isin(used["frame"])], place.pose.shape)
        cut_notes = frame_notes(pd.DataFrame(cut.items(), columns=["frame", "message"]))
        notes += [f"{place.name}, {note}" for note in cut_notes]
    for row in unused.to_dict("records"):
        if np.isnan(row["area_m2"]) or row["load_N"] > 0:
            reason = row["message"] or "it has no area"
        else:
            reason = "its load is not known" if np.isnan(row["load_N"]) else "its load is not above zero"
        notes.append(f"{place.name}, {row['frame']}: left out: {reason}")
    return notes


# --- one load averaged over annuli and places


@dataclass(frozen=True, eq=False)
class LoadAverage:
    """Averages at one load.

    Parameters
    ----------
    name : str
        Of the frames, or of the load.
    load : float, N
    moments : dict
        Model -> place -> sums over annuli, all with the same edges.
    profile, normalised : DataFrame
        Columns of `contactimg.tables.PROFILE` and `contactimg.tables.NORMALISED`.
    ring_area : float, m^2
        Of the Greenwood-Tripp model; NaN if it was not solved.
    """

    name: str
    load: float
    moments: dict[str, dict[str, pd.DataFrame]]
    profile: pd.DataFrame
    normalised: pd.DataFrame
    ring_area: float


def _density(place: Place) -> float:
    """Asperities per unit area of the surface of a place, 1/m^2; NaN if it is not known."""
    section = place.scene.asperities
    try:
        return np.nan if section is None else asperity_density(section, place.asperities)
    except InputError:
        return np.nan


def _average_load(
    name: str, load: float, seen: Seen, options: AnalysisOptions, notes: list[str]
) -> LoadAverage:
    """Average the contacts of one load over annuli; where models were solved, Greenwood-Tripp is added.

    ``name`` and ``load`` are those of a group of frames; what cannot be computed is added to the notes.
    """
    shots = {model: [place.at(load) for place in places] for model, places in seen.items()}
    every = [place for places in shots.values() for place in places]
    widths = (annulus_edges(one.contacts, centre=one.centre, width=options.annulus) for one in every)
    edges, scene = max(widths, key=len), every[0].scene  # the annuli that hold the contacts of all places
    moments = {
        model: {one.name: annuli_of(one, edges, options.min_radius_px) for one in places if len(one.frames)}
        for model, places in shots.items()
    }
    profiles = [
        radial_profiles.average_profile(list(tables.values()), frame=name, model=model)
        for model, tables in moments.items()
        if tables
    ]
    ring_area, normalised = np.nan, NORMALISED.empty()
    if len(seen) > 1:
        lost, caps = f"{name}: no Greenwood-Tripp curve", every[0].asperities
        rings = fit_or_note(notes, lost, predict_average, scene, caps, load=load, model="gt")
        if rings is not None:
            ring_area = float(rings.frames["area_m2"].iloc[0])
            profiles.append(radial_profiles.ring_profile(rings.profile, edges, frame=name))
    if scene.indenter is not None and scene.elastic is not None:
        smooth = {"sphere_radius": scene.indenter.radius, "contact_modulus": scene.elastic.contact_modulus}
        profiles.append(radial_profiles.hertz_profile(edges, load=load, frame=name, **smooth))
        normalised = radial_profiles.normalise_profile(PROFILE.joined(profiles), load=load, **smooth)
    return LoadAverage(name, load, moments, PROFILE.joined(profiles), normalised, ring_area)


POINT_COLUMNS = {"r": "r_m", "n": "n_contacts"} | {
    f"{name}{std}": f"{name}{std}_{unit}"
    for name, unit in (("pressure", "Pa"), ("density", "per_m2"), ("mean_radius", "m"))
    for std in ("", "_std")
}
"""Columns of `contactimg.analysis.contacts_against_pressure.pressure_points` -> those of the table."""


def _points(average: LoadAverage, density: float) -> pd.DataFrame:
    """Density and mean radius against the local pressure, columns of `contactimg.tables.PRESSURE_LAW`."""
    parts = [pd.DataFrame()]
    for model, places in average.moments.items():
        if model == "uncoupled" or not places:
            continue
        found = pressure_points(sum_moments(places.values()), by_those_beside=True)
        ratios = {f"density_ratio{std}": found[f"density{std}"] / density for std in ("", "_std")}
        parts.append(found.assign(**ratios, frame=average.name, model=model, load_N=average.load))
    points = pd.concat(parts).rename(columns=POINT_COLUMNS)
    return PRESSURE_LAW.conform(points.filter(list(PRESSURE_LAW.columns)))


# --- tables and laws


def _areas(
    places: Sequence[Place], seen: Seen, means: list[LoadAverage], options: AnalysisOptions, notes: list[str]
) -> tuple[pd.DataFrame, dict[str, PowerLaw]]:
    """Areas of each load, and exponents of A(P), measured and of every model."""
    density, tables, laws = _density(places[0]), list[pd.DataFrame](), dict[str, PowerLaw]()
    stated = {name: getattr(options, name) for name in ("load_relative_std", "load_std")}
    for model, own in seen.items():
        parts = [frame_areas(one.frames, one.contacts, place=one.name, centre=one.centre) for one in own]
        areas = pd.concat([table for table in parts if len(table)] or parts, ignore_index=True)
        groups = np.concatenate([one.frames["group"].to_numpy(np.intp) for one in own])
        table = area_by_load(areas, groups, model=model, asperity_density=density)
        spread = np.hypot(options.load_relative_std * table["load_N"], options.load_std)
        tables.append(table.assign(load_std_N=spread / np.sqrt(table["n_frames"].astype(float))))
        cell = LoadCell.stated(places[0].scene.load) if model == "measured" else EXACT_LOADS
        law = fit_or_note(notes, f"A(P), {model}", fit_area_law, areas, load_cell=cell, **stated)
        laws |= {} if law is None else {model: law}
    rings = [("gt", one.load, one.ring_area) for one in means if np.isfinite(one.ring_area)]
    tables.append(AREA.conform(pd.DataFrame(rings, columns=["model", "load_N", "area_m2"])))
    return AREA.joined(tables), laws


def _local_laws(averages: list[LoadAverage], own: str, notes: list[str]) -> dict[tuple[str, str], BrokenLaw]:
    """Density and mean radius against the local pressure, of the runs and of the coupled model."""

    def law(quantity: str, model: str) -> BrokenLaw:
        loads = [average.moments[model] for average in averages if average.moments[model]]
        return fit_contact_law(loads, quantity)

    models = [model for model in averages[0].moments if model != "uncoupled"]
    if not any(place["n_forces"].any() for average in averages for place in average.moments[own].values()):
        notes.append("no profiles and no laws of the pressure: no contact above min_radius_px has a force")
        return {}
    keys = [(quantity, model) for quantity in QUANTITIES for model in models]
    laws = {key: fit_or_note(notes, f"{key[0]} against pressure, {key[1]}", law, *key) for key in keys}
    return {key: law for key, law in laws.items() if law is not None}


def _friction_table(places: Sequence[Place]) -> pd.DataFrame:
    """Frames with a friction force and an area."""
    columns, own = ["frame", "friction_N", "velocity_m_s"], ["frame", "load_N", "area_m2", "area_std_m2"]
    tables = [one.loads[columns].merge(one.frames[own], on="frame").assign(place=one.name) for one in places]
    both = pd.concat(tables).dropna(subset=["friction_N", "area_m2"])
    stress = both["friction_N"].abs() / both["area_m2"].where(both["area_m2"] > 0)
    return FRICTION.conform(both.assign(stress_Pa=stress))


def _shear_stress(friction: pd.DataFrame, options: AnalysisOptions) -> ShearStress:
    """The shear stress of all frames that slide; those of velocity 0 show static forces."""
    sliding = friction[~(friction["velocity_m_s"] == 0)]
    return fit_shear_stress(sliding, friction_std=options.friction_std)


def _velocity_law(friction: pd.DataFrame, options: AnalysisOptions, notes: list[str]) -> PowerLaw | None:
    """The shear stress against velocity, if there are several velocities."""
    if not (friction["velocity_m_s"].abs() > 0).any():
        return None
    std = options.friction_std
    stress = fit_or_note(notes, "friction", stress_by_velocity, friction, friction_std=std)
    if stress is None or len(stress) < 2:
        return None
    x, y, y_std = (stress[name] for name in ("velocity_m_s", "stress_Pa", "stress_std_Pa"))
    # of one frame without a stated error nothing is known: no weights
    return fit_power_law(x, y, y_std=0.0 if y_std.isna().any() else y_std)


# --- numbers, tables and figures


def result_rows(analysis: Analysis) -> pd.DataFrame:
    """The numbers of an analysis, columns of `contactimg.tables.RESULTS`."""
    rows: list[dict[str, Any]] = []

    def add(fit: dict[str, Any], quantity: str, found: Estimate | float, unit: str, note: str) -> None:
        estimate = found if isinstance(found, Estimate) else Estimate(found, np.nan, np.nan, np.nan)
        interval = {name: getattr(estimate, name) for name in ("value", "std", "low", "high")}
        rows.append({"quantity": quantity, "unit": unit, "note": note} | interval | fit)

    for model, law in analysis.area_laws.items():
        fit = _fit(model, law, "N", law.n_places)
        source = "between places" if law.n_places > 1 else "within the place, and stated errors"
        note = "A ~ P^m, errors in A and P; of this surface, whatever its places: interval from scatter "
        add(fit, "area_exponent", law.exponent, "1", note + source)
        note = f"A of that law at {law.reference:.6g} N, the geometric mean of the loads"
        add(fit, "area_at_mean_load", law.amplitude, "m2", note)
        if law.zero:
            note = "zero of the load cell, fitted as the scene states zero_std_N, and taken off the loads"
            add(fit, "area_load_zero", law.zero, "N", note)
        note = "relative scatter of A about the law beyond the stated errors"
        add(fit, "area_excess_scatter", law.scatter, "1", note)
    for (quantity, model), broken in analysis.contact_laws.items():
        single, name = broken.single, f"{quantity}_exponent"
        fit = _fit(model, single, "Pa", single.n_places)
        note = f"{quantity} ~ p^m, one law; of this surface, whatever its places"
        add(fit, name, single.exponent, "1", note)
        note = "probability of as much gain by a break that is not there (Davies)"
        add(fit, f"{quantity}_break_p_value", broken.p_value, "1", note)
        if broken.supported:
            add(fit, f"{name}_above", broken.high_exponent, "1", "above p*")
            add(fit, f"{name}_below", broken.low_exponent, "1", "below p*")
            note = "p*, where the two laws meet; interval from the bootstrap"
            add(fit, f"{quantity}_break_pressure", broken.break_x, "Pa", note)
    stress, speed = analysis.shear_stress, analysis.velocity_law
    n_places = analysis.friction["place"].nunique()
    if stress is not None:
        fit = _fit("measured", stress, "m2", n_places)
        note = "tau0 of Q = tau0 A, least squares through the origin, errors in A and Q"
        add(fit, "shear_stress", stress.stress, "Pa", note)
        if analysis.smooth_stress is not None:
            ratio = compare_stress(stress, analysis.smooth_stress)
            add(fit, "shear_stress_ratio", ratio, "1", "tau0 over that of the smooth contact")
    if speed is not None:
        fit = _fit("measured", speed, "m/s", n_places)
        note = "tau0 ~ v^m, one shear stress at each velocity; 0 where friction does not depend on it"
        add(fit, "shear_stress_velocity_exponent", speed.exponent, "1", note)
    for quantity, found, unit, note, n_points in analysis.sheared.rows():
        fit = {"model": "measured", "n_points": n_points, "n_places": n_places}
        add(fit | {"confidence": COVERAGE}, quantity, found, unit, note)
    return RESULTS.conform(pd.DataFrame(rows, columns=list(RESULTS.columns)))


def _fit(model: str, law: PowerLaw | ShearStress, unit: str, n_places: float) -> dict[str, Any]:
    """The data behind a law: confidence level, points, places, and the fitted range of the abscissa."""
    ends = {"model": model, "range_low": law.low, "range_high": law.high, "range_unit": unit}
    return ends | {"confidence": law.confidence, "n_points": law.n_points, "n_places": n_places}


def write_analysis(analysis: Analysis, folder: Path) -> pd.DataFrame:
    """Write the tables of an analysis and its figures.

    Parameters
    ----------
    analysis : Analysis
    folder : Path
        Exists.

    Returns
    -------
    DataFrame
        The numbers of the analysis, results.csv.
    """
    results = result_rows(analysis)
    tables = [(AREA, analysis.area), (PROFILE, analysis.profile), (NORMALISED, analysis.normalised)]
    tables += [(PRESSURE_LAW, analysis.pressure_law), (RESULTS, results)]
    if len(analysis.friction):
        tables.append((FRICTION, analysis.friction))
    figures = {"area": plot_areas(analysis.area, analysis.area_laws)}
    if len(analysis.sheared.followed):
        tables.append(analysis.sheared.table())
    if analysis.sheared.laws:
        figures["sheared_areas"] = plot_sheared_areas(analysis.sheared.followed)
    normalised = analysis.normalised
    known = normalised["model"].isin(RUN_MODELS) & normalised["pressure_over_hertz"].notna()
    frames = normalised["frame"][known].unique()
    for number, frame in enumerate(frames, start=1):
        part = normalised[normalised["frame"] == frame]
        figures[f"profile_{number:0{len(str(len(frames)))}d}"] = plot_profile(part)
    for quantity in QUANTITIES if len(analysis.pressure_law) else ():
        figures[quantity] = plot_pressure_law(analysis.pressure_law, analysis.contact_laws, quantity)
    if analysis.shear_stress is not None:
        figures["friction"] = plot_friction(analysis.friction, analysis.shear_stress, analysis.smooth_stress)
    write_results(folder, tables, figures)
    return results
