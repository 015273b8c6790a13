"""Slips that physics can tell: a value in another unit, columns that were swapped, a lens elsewhere.

Every command compares magnitudes of its scene, and of what it measured, with the range of what is made or
expected. A value outside is an error that names it and the unit that was probably meant; within
`doubts_as_warnings` it is a warning.
"""

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from contactimg.engine.progress import holding
from contactimg.errors import InputError
from contactimg.mechanics import hertz
from contactimg.pose.apex import Apex
from contactimg.pose.fit import SIGNIFICANT_FRACTION
from contactimg.scene import Scene
from contactimg.scene.sections import FLAT

logger = logging.getLogger(__name__)

CONTACT_OVER_RADIUS = "the smooth sphere's contact over its radius"
CONTACT_OVER_SAMPLE = "the smooth sphere's contact over half the diagonal of the sample"

RANGES = {
    # chosen, a decade beyond what is made or used: from gels to diamond, from microspheres to optical flats
    "young_modulus_Pa": (1e3, 1.3e12),
    "poisson_ratio": (0.2, 0.5),
    "work_of_adhesion_J_m2": (0.0, 10.0),
    "thickness_m": (1e-7, 1.0),
    "[indenter] radius_m": (1e-7, 5.0),
    "load_N": (-1e3, 1e5),
    "the median of radius_m of the asperities": (1e-9, 0.05),
    # light resolves 0.2 um, sampled ten times at most
    "pixel_size_m": (2e-8, 5e-4),
    # chosen: random asperities differ by a few tens, a slip of a unit in one row by 1000
    "radius_m of one asperity over the median": (1 / 300, 300.0),
    # chosen, for places as for radii: random ones differ by a few, a slip of a unit by 1000
    "distance of one asperity from the median over that of most": (0.0, 100.0),
    "longer side of the asperities over the shorter": (1.0, 100.0),
    # a cap is no higher than its sphere
    "height_m over radius_m of the asperities": (0.0, 1.0),
    # an output that may change by all of itself is not asked for
    "[tolerance] relative": (0.0, 0.99),
    # chosen: nothing is known to 1e-6, and what may be zero is not known
    "standard uncertainty over its value": (1e-6, 1.0),
    # chosen: shallow caps reach a few, sparse samples 0.1
    "radius_m of the asperities over their distance": (1e-3, 30.0),
    # chosen: of random places in a table of 10^4 a pair is so close once in 60 tables
    "distance of the closest asperities over the mean one": (1e-3, np.inf),
    # chosen: an indenter that stands beside its sample touches it in a corner at most
    "distance from the asperities over their side": (0.0, 0.5),
    # chosen: small-strain contact mechanics holds to about 0.1, and nothing of it is left at 0.5
    CONTACT_OVER_RADIUS: (0.0, 0.5),
    # chosen: a contact beyond the table would lose its forces anyway
    CONTACT_OVER_SAMPLE: (0.0, 1.5),
    # chosen, over the largest load: few loads of a cell good to a tenth reach 0.2, loads in any order 0.3
    "scatter of the loads about the law": (0.0, 0.25),
    # chosen: a modulus that was measured otherwise agrees within a few; a slip of a unit gives 10 to 1000
    "forces over load": (1 / 8, 8.0),
    # chosen, of the closest threshold: thresholds change the sum by a few
    "forces over load of all thresholds": (1 / 30, 30.0),
}
"""What is compared -> its plausible values."""

UNITS = {
    "m": {"mm": 1e-3, "µm": 1e-6, "nm": 1e-9, "mm, typed as µm": 1e3},
    "Pa": {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "N": {"mN": 1e-3, "grams": 9.80665e-3, "kilograms": 9.80665, "kN": 1e3},
    "m2": {"mJ/m2": 1e-3},
    "[tolerance] relative": {"per cent": 1e-2},
}
"""End of a name -> units that may have been typed instead, and their size."""

SHOWN_STDS = 5.0
"""Standard deviations by which the apex or the lens that the contacts show must differ."""

FORCES_OFF_LOAD = 1.5
"""Ratio of the sum of local forces to the load, or its inverse, from which on they contradict each other.
Chosen: above what an uncalibrated modulus or threshold is off by, below a slip of a unit. The ratio is always
printed."""

_warn_only: ContextVar[bool] = ContextVar("warn_only", default=False)


def doubts_as_warnings() -> AbstractContextManager[None]:
    """Log doubts as warnings instead of raising them, inside the block."""
    return holding(_warn_only, value=True)


def warn_of(doubts: Iterable[str], place: str) -> bool:
    """Log doubts about a result that is written; return whether they count, without ``--no-plausibility``."""
    doubts = list(doubts)
    for doubt in doubts:
        logger.warning("%s: %s", place, doubt)
    return bool(doubts) and not _warn_only.get()


def settle(doubts: Iterable[str], place: str | Path) -> None:
    """Raise an `InputError` of the first doubt about a place, or log all inside `doubts_as_warnings`."""
    doubts = list(doubts)
    if _warn_only.get():
        warn_of(doubts, str(place))
    elif doubts:
        more = f" (and {len(doubts) - 1} more of this kind)" if len(doubts) > 1 else ""
        allow = "--no-plausibility (Python: doubts_as_warnings)"
        raise InputError(f"{place}: {doubts[0]}{more}; correct it, or give {allow} if it is right")


def doubt_about(key: str, value: float, *, said: str = "", hint: str = "") -> Iterator[str]:
    """A sentence about a value outside its range, with the units that would bring it inside."""
    low, high = RANGES[key]
    if not low <= value <= high:
        typed = UNITS.get(key.removesuffix(" of the asperities").rpartition("_")[2], {})
        units = " or ".join(unit for unit, size in typed.items() if low <= value * size <= high)
        hint = hint or f"was it given in {units or 'another unit'}?"
        yield f"{said or key} = {value:.3g} is outside the plausible range {low:g} ... {high:g}; {hint}"


def doubts_about_scene(
    scene: Scene, asperities: pd.DataFrame | None = None, loads: Sequence[float] = ()
) -> Iterator[str]:
    """Sentences about values of a scene, its asperity table and its loads (N) that are probably slips.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> list(doubts_about_scene(scene_from_dict({"camera": {"pixel_size_m": 6.0}})))
    ['pixel_size_m = 6 is outside the plausible range 2e-08 ... 0.0005; was it given in µm?']
    """
    for section, keys in scene.configuration.items():
        for key, value in keys.items():
            name = key if key in RANGES else f"[{section}] {key}"
            if name in RANGES and value != FLAT:
                yield from doubt_about(name, value)
    loads = [*loads, *(scene.simulate.loads if scene.simulate is not None else [])]
    for load in {min(loads), max(loads)} if loads else ():
        yield from doubt_about("load_N", load)
    half_diagonal = np.inf
    if asperities is not None and len(asperities) > 1:
        yield from _doubts_about_table(scene, asperities)
        half_diagonal = float(np.hypot(*np.ptp(asperities[["x_m", "y_m"]].to_numpy(float), axis=0))) / 2
    elastic, heaviest = scene.elastic, max(loads, default=0.0)
    stated = [("[load] zero_std_N", scene.load.zero_std or 0.0, heaviest)]
    if elastic is not None:
        stated.append(("young_modulus_std_Pa", elastic.young_modulus_std, elastic.stated_modulus or 0.0))
    for name, std, value in stated:
        if std and value:
            key, hint = "standard uncertainty over its value", "is one of them relative, or in another unit?"
            yield from doubt_about(key, std / abs(value), said=f"{name} over {value:g}", hint=hint)
    lens = np.inf if scene.indenter is None else scene.indenter.radius
    if elastic is not None and elastic.stated_modulus is not None and heaviest > 0 and lens < np.inf:
        contact = hertz.radius(heaviest, sphere_radius=lens, contact_modulus=elastic.contact_modulus)
        hint = "is the load in mN or grams, a length in mm, the modulus in MPa?"
        for key, length in ((CONTACT_OVER_RADIUS, lens), (CONTACT_OVER_SAMPLE, half_diagonal)):
            said = key.replace(" over", f" at {heaviest:g} N over")
            yield from doubt_about(key, float(contact / length), said=said, hint=hint)


def _doubts_about_table(scene: Scene, asperities: pd.DataFrame) -> Iterator[str]:
    """Columns and units of the asperities; apex and camera outside the sample."""
    height, radius = (float(asperities[name].abs().median()) for name in ("height_m", "radius_m"))
    yield from doubt_about("the median of radius_m of the asperities", radius)
    ratios = asperities["radius_m"].to_numpy(float) / radius
    for row in (int(ratios.argmin()), int(ratios.argmax())):
        said, key = f"radius_m of asperity {row} over the median", "radius_m of one asperity over the median"
        yield from doubt_about(key, ratios[row], said=said, hint="is it in another unit than the others?")
    columns = "are columns swapped, in different units, or heights of the wrong sign?"
    upright = -1.0 if asperities["height_m"].max() < 0 else 1.0
    yield from doubt_about(
        "height_m over radius_m of the asperities", upright * height / radius, hint=columns
    )
    points = asperities[["x_m", "y_m"]].to_numpy(float)
    heights, sides = asperities[["height_m"]].to_numpy(float), np.sort(np.ptp(points, axis=0))
    for name, values in (("x_m or y_m", points), ("height_m", heights)):
        off = np.linalg.norm(values - np.median(values, axis=0), axis=1)
        row, key = int(off.argmax()), "distance of one asperity from the median over that of most"
        said = key.replace("one asperity", f"asperity {row}")
        hint = f"is its {name} in another unit than that of the others?"
        yield from doubt_about(key, off[row] / max(np.median(off), radius), said=said, hint=hint)
    if sides[0] > radius:  # not a row of caps
        key, hint = "longer side of the asperities over the shorter", "are x_m and y_m in different units?"
        yield from doubt_about(key, sides[1] / sides[0], hint=hint)
    if spacing := mean_spacing(asperities):
        cure, key = "are x_m, y_m and radius_m in metres?", "radius_m of the asperities over their distance"
        yield from doubt_about(key, radius / spacing, hint=cure)
        distances, nearest = np.asarray(cKDTree(points).query(points, k=2))[..., 1]
        one = int(distances.argmin())
        said = f"distance of the asperities {one} and {int(nearest[one])} over the mean one"
        key = "distance of the closest asperities over the mean one"
        yield from doubt_about(key, distances[one] / spacing, said=said, hint="is one of them there twice?")
    low, high = points.min(axis=0), points.max(axis=0)

    def outside(place: tuple[float, float], factor: float = 1.0) -> float:
        point = factor * np.array(place)
        return float(np.hypot(*np.maximum(np.maximum(low - point, point - high), 0.0)) / np.max(high - low))

    places = {}
    if scene.indenter is not None and "apex" in scene.indenter.model_fields_set:
        places["[indenter] apex_m"] = scene.indenter.apex
    if scene.camera is not None and scene.camera.centre is not None:
        places["[camera] centre_m"] = scene.camera.centre
    for name, place in places.items():
        unit = next((unit for unit, size in UNITS["m"].items() if outside(place, size) == 0), "")
        hint = f"was it given in {unit or 'another unit, or with another sign'}?"
        said = f"distance of {name} ({place[0]:g}, {place[1]:g}) from the asperities over their side"
        away = outside(place)
        yield from doubt_about("distance from the asperities over their side", away, said=said, hint=hint)


def doubts_about_calibration(
    *, young_modulus: float, work_of_adhesion: float, contact_over_radius: float, scatter: float
) -> Iterator[str]:
    """Sentences about a JKR calibration.

    That is modulus (Pa), work of adhesion (J/m^2), contact over sphere, and scatter of the loads about the
    law over the largest load.
    """
    hint = "are loads in N, and pixel_size_m and radius_m in metres?"
    said = "the largest contact radius over that of the sphere"
    adhesion = max(work_of_adhesion, 0.0)
    yield from doubt_about(CONTACT_OVER_RADIUS, contact_over_radius, said=said, hint=hint)
    order = "do the loads belong to the frames, in their order?"
    yield from doubt_about("scatter of the loads about the law", scatter, hint=order)
    yield from doubt_about("young_modulus_Pa", young_modulus, said="the fitted young_modulus", hint=hint)
    yield from doubt_about("work_of_adhesion_J_m2", adhesion, said="the fitted work_of_adhesion", hint=hint)


def doubts_about_forces(*, slope: float, young_modulus: float, scanned: bool = False) -> Iterator[str]:
    """A sentence about forces found with a modulus (Pa) that add up to ``slope`` times the load.

    ``scanned`` says that it is the slope of the closest of many thresholds.

    Examples
    --------
    >>> list(doubts_about_forces(slope=0.9, young_modulus=3e6))
    []
    """
    hint = "are loads in N, the modulus in Pa, and pixel_size_m and the radii in metres?"
    said = f"the sum of the local forces over the load, with young_modulus_Pa = {young_modulus:g},"
    if slope > 0:
        key = "forces over load of all thresholds" if scanned else "forces over load"
        yield from doubt_about(key, slope, said=said, hint=hint)


def doubts_about_run(scene: Scene, frames: pd.DataFrame, shown: Apex | None) -> Iterator[str]:
    """Sentences about what the measured frames tell of slips in loads, references and lens.

    Parameters
    ----------
    scene : Scene
    frames : DataFrame
        Columns of `contactimg.tables.FRAMES`.
    shown : Apex or None
        Apex and radius of the lens that the contacts show.
    """
    if not (frames["n_contacts"].fillna(0) > 0).any():
        polarity = f'contacts are not {scene.images.polarity} ([images] polarity, "auto" finds out)'
        reference = "a frame with contacts is named as the reference, or " if scene.images.reference else ""
        yield f"no frame shows a contact: probably {reference}{polarity}"
        return
    loaded = frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]
    loads, areas = loaded["load_N"], loaded["area_m2"]
    # chosen: the order of two loads can be exchanged by adhesion or drift
    if loads.nunique() > 2 and loads.rank().corr(areas.rank()) < 0:
        yield "the area of contact falls as the load grows: is the order of the loads reversed?"
    ratio = float((loaded["force_sum_N"] / loads).median())
    # forces grow with the cube of the pixel size
    binned = {"twice": 2.0**3, "half": 0.5**3}.items()
    slips = {f"is pixel_size_m {times} that of the frames (binning)": cube for times, cube in binned}
    slips |= {f"were the loads given in {unit}": size for unit, size in UNITS["N"].items()}
    meant = [slip for slip, k in slips.items() if 1 / FORCES_OFF_LOAD < ratio / k < FORCES_OFF_LOAD]
    if meant:
        yield f"the forces add up to {ratio:.2g} times load_N: {', or '.join(meant)}?"
    if scene.indenter is not None and (lens := _other_lens(scene, shown)):
        yield (
            f"{lens}, and [indenter] radius_m = {scene.indenter.radius:.3g}: is that of another lens, or "
            "pixel_size_m not of this camera?"
        )


def _other_lens(scene: Scene, shown: Apex | None) -> str:
    """A sentence on the lens that the contacts show, where it is not the stated one; else empty."""
    if scene.indenter is None or shown is None or shown.radius is None:
        return ""
    off = abs(shown.radius / scene.indenter.radius - 1)
    # 0.2 is chosen: above what a thin layer or a cut field of view changes
    differs = off > max(0.2, SHOWN_STDS * shown.radius_std / shown.radius)
    return f"the contacts show a lens of {shown.radius:.3g} m" if differs else ""


def doubts_about_match(
    scene: Scene, *, measured: int, predicted: int, matched: int, shown: Apex | None, spacing: float = np.inf
) -> Iterator[str]:
    """A sentence where measured and predicted contacts are not the same ones, with the likely cause.

    In a dense pattern most contacts of a lens that stands elsewhere are the same ones. Therefore the apex
    that the contacts show decides as well, if it is more than half a ``spacing`` (m) of the asperities away.
    """
    causes, wrong = [], 2 * matched < SIGNIFICANT_FRACTION * (measured + predicted)
    if shown is not None and scene.indenter is not None:
        apart = float(np.hypot(*np.subtract(shown.place, scene.indenter.apex)))
        if apart > SHOWN_STDS * np.hypot(*shown.std):
            wrong |= apart > spacing / 2
            x, y = shown.place
            place = "[indenter] apex_m, or the centre of the calibration used"
            causes.append(f"{place}: the contacts show the apex at ({x:.6g}, {y:.6g}) m")
    if lens := _other_lens(scene, shown):
        causes.append(f"[indenter] radius_m: {lens}")
    cause = ", and ".join(causes) or (
        "the apex, [camera] mirrored, rotation_deg or pixel_size_m, the modulus, or the load (grams or mN?)"
    )
    if wrong:
        counts = f"{matched} of {measured} measured and {predicted} predicted contacts match"
        yield f"{counts}; likely cause: {cause}"


def mean_spacing(asperities: pd.DataFrame) -> float:
    """Mean distance of asperities, m: that of as many on a square lattice over the same box."""
    spans = np.ptp(asperities[["x_m", "y_m"]].to_numpy(float), axis=0)
    return float(np.sqrt(np.prod(spans) / max(len(asperities), 1)))
