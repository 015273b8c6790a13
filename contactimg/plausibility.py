"""Slips that physics can tell: a value in another unit, columns that were swapped, a sign.

Every command checks its scene before it computes. A doubt is an error that names the value, the plausible
range and the unit that was probably meant; within `doubts_as_warnings` it is a warning.
"""

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactimg.errors import InputError
from contactimg.mechanics import hertz
from contactimg.pose.apex import Apex
from contactimg.scene import Scene

logger = logging.getLogger(__name__)

MAX_CONTACT_OVER_RADIUS = 0.5
"""Contact radius over radius of curvature above which no model here describes a contact. Chosen: small-strain
contact mechanics holds to about 0.1, and nothing of it is left at 0.5."""

MAX_CONTACT_OVER_SAMPLE = 1.5
"""Radius of the smooth sphere's contact over half the diagonal of the asperity table above which the load,
the modulus or the radius is doubted. Chosen; a contact beyond the table would lose its forces anyway."""

MAX_APEX_DISTANCE = 0.5
"""Distance of the apex from the box of the asperities, as a fraction of the longer side. Chosen: an indenter
that stands beside its sample touches it in a corner at most."""

MAX_RADIUS_OVER_SPACING = 30.0
"""Radius of the asperities over their mean distance. Chosen: shallow caps reach a few."""

MAX_SPACING_OVER_RADIUS = 1000.0
"""Mean distance of the asperities over their radius. Chosen: sparse samples reach some tens."""

OPPOSITE_SHARE = 0.05
"""Share of the asperities up to which those on the other side of zero are doubted if they stand alone."""

ALONE_SPACINGS = 4.0
"""Distance to the next asperity, in mean spacings, from which one stands alone. Chosen: in a random pattern
of 10^4 points the largest such distance is below 2 (theory: exp(-pi x^2) per point)."""

MAX_FORCES_OVER_LOAD = 8.0
"""Sum of the local forces over the load, or its inverse, that is doubted where the modulus is calibrated.
Chosen: a modulus that was measured otherwise agrees within a few; the radii off by ten give 10, N for mN, MPa
for kPa and the pixel size off by ten 1000, pixel size and radii 100."""

MAX_SCANNED_FORCES_OVER_LOAD = 30.0
"""The same at the threshold that comes closest, where that is calibrated. Chosen: thresholds alone change the
sum by up to a few."""

FEWEST_MATCHES = 0.5
"""Share of the measured and predicted contacts that must be the same ones. Chosen: a right scene has 0.9, one
with a wrong apex next to nothing."""

SAME_COUNT = 1.5
"""Ratio of predicted to measured contacts, or its inverse, from which on the load is doubted. Chosen."""

SHOWN_STDS = 5.0
"""Standard deviations by which the apex or the lens that the contacts show must differ. Chosen."""

SLIPS = {1 / 101.97: "grams", 9.80665: "kilograms", 1e-3: "mN", 1e3: "kN", 1e-6: "µN"}
"""Forces over load -> what the loads were probably typed in, instead of N."""

SAME_SLIP = 2.0
"""Factor within which the forces over load are those of a slip. Chosen: above what a modulus is off by."""

FEWEST_LOADS = 3
"""Different loads of which the order is judged. Chosen: two can be exchanged by adhesion or drift."""

SHOWN_RADIUS = 0.2
"""Relative difference of the lens's radius that is named. Chosen: above what a thin layer or a cut field of
view changes."""

_FACTORS = {1e-3: "mm", 1e-6: "µm", 1e-9: "nm", 1e-2: "cm"}


@dataclass(frozen=True)
class PlausibleRange:
    """The range in which a quantity of an experiment lies.

    Parameters
    ----------
    low, high : float
        In the unit.
    unit : str
    below, above : str
        The slip that probably gave a value outside.
    """

    low: float
    high: float
    unit: str
    below: str
    above: str

    def doubt(self, name: str, value: float) -> Iterator[str]:
        """A sentence about a value outside the range."""
        if not self.low <= value <= self.high:
            hint = self.below if value < self.low else self.above
            said = f"{name} = {value:g} {self.unit}".rstrip()
            said += f" is outside the plausible range {self.low:g} ... {self.high:g}"
            yield f"{said}; {hint}" if hint else said


# chosen, a decade beyond what is made or used: from gels to diamond, microspheres to optical flats
YOUNG_MODULUS = PlausibleRange(
    1e3, 1.3e12, "Pa", "was it given in MPa or GPa?", "is a length in another unit?"
)
POISSON_RATIO = PlausibleRange(0.2, 0.5, "", "rubber has 0.5; was it given in another unit?", "")
INDENTER_RADIUS = PlausibleRange(1e-7, 5.0, "m", "", "was it given in mm or µm?")
PIXEL_SIZE = PlausibleRange(
    2e-8, 5e-4, "m", "were mm typed as µm?", "was it given in µm or mm?"
)  # light resolves 0.2 µm, sampled ten times at most
THICKNESS = PlausibleRange(1e-7, 1.0, "m", "", "was it given in mm or µm?")
WORK_OF_ADHESION = PlausibleRange(0.0, 10.0, "J/m^2", "", "was it given in mJ/m^2, or are loads in mN?")
LOAD = PlausibleRange(-1e3, 1e5, "N", "were loads given in mN?", "were loads given in mN or µN?")
ASPERITY_RADIUS = PlausibleRange(1e-9, 0.05, "m", "", "was it given in mm or µm?")

_warn_only: ContextVar[bool] = ContextVar("warn_only", default=False)


@contextmanager
def doubts_as_warnings() -> Iterator[None]:
    """Log doubts as warnings instead of raising them."""
    token = _warn_only.set(True)
    try:
        yield
    finally:
        _warn_only.reset(token)


def settle(doubts: Iterable[str], place: str) -> None:
    """Raise or log doubts.

    Parameters
    ----------
    doubts : iterable of str
    place : str
        The file or the result that they are about.

    Raises
    ------
    InputError
        With the first doubt, unless inside `doubts_as_warnings`.
    """
    doubts = list(doubts)
    if _warn_only.get():
        warn_of(doubts, place)
    elif doubts:
        more = f" (and {len(doubts) - 1} more of this kind)" if len(doubts) > 1 else ""
        raise InputError(f"{place}: {doubts[0]}{more}; correct it, or give --no-plausibility if it is right")


def doubts_about_scene(
    scene: Scene, asperities: pd.DataFrame | None = None, loads: Sequence[float] = ()
) -> Iterator[str]:
    """Sentences about values of a scene that are probably slips.

    Parameters
    ----------
    scene : Scene
    asperities : DataFrame, optional
        Its asperity table.
    loads : sequence of float
        Its loads, N.

    Yields
    ------
    str

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> list(doubts_about_scene(scene_from_dict({"elastic": {"young_modulus_Pa": 3.0}})))
    ['young_modulus_Pa = 3 Pa is outside the plausible range 1000 ... 1.3e+12; was it given in MPa or GPa?']
    """
    elastic, camera, indenter = scene.elastic, scene.camera, scene.indenter
    stated: list[tuple[str, float | None, PlausibleRange]] = []
    if elastic is not None:
        stated += [
            ("young_modulus_Pa", elastic.stated_modulus, YOUNG_MODULUS),
            ("poisson_ratio", elastic.poisson_ratio, POISSON_RATIO),
            ("work_of_adhesion_J_m2", elastic.work_of_adhesion, WORK_OF_ADHESION),
            ("thickness_m", elastic.thickness, THICKNESS),
        ]
    stated += [] if camera is None else [("pixel_size_m", camera.pixel_size, PIXEL_SIZE)]
    stated += [] if indenter is None else [("[indenter] radius_m", indenter.radius, INDENTER_RADIUS)]
    loads = [*loads, *(scene.simulate.loads if scene.simulate is not None else [])]
    stated += [("load_N", load, LOAD) for load in sorted({min(loads), max(loads)} if loads else ())]
    for name, value, plausible in stated:
        if value is not None:
            yield from plausible.doubt(name, value)
    half_diagonal = np.inf
    if asperities is not None and len(asperities) > 1:
        yield from _doubts_about_asperities(asperities)
        yield from _doubts_about_places(scene, asperities)
        half_diagonal = float(np.hypot(*np.ptp(_points(asperities), axis=0))) / 2
    if loads and max(loads) > 0:
        yield from _doubts_about_strain(scene, max(loads), half_diagonal)


def doubts_about_calibration(
    *, young_modulus: float, work_of_adhesion: float, contact_over_radius: float
) -> Iterator[str]:
    """Sentences about the result of a JKR calibration.

    Parameters
    ----------
    young_modulus : float
        Pa.
    work_of_adhesion : float
        J/m^2.
    contact_over_radius : float
        Largest contact radius over the radius of the sphere.

    Yields
    ------
    str
    """
    if contact_over_radius > MAX_CONTACT_OVER_RADIUS:
        yield (
            f"the largest contact radius is {contact_over_radius:.2g} of the radius of the sphere, beyond "
            f"{MAX_CONTACT_OVER_RADIUS:g} no model holds; are pixel_size_m and radius_m in metres?"
        )
    hint = "are loads in N, and pixel_size_m and radius_m in metres?"
    modulus, adhesion = (replace(one, below=hint, above=hint) for one in (YOUNG_MODULUS, WORK_OF_ADHESION))
    yield from modulus.doubt("the fitted young_modulus", young_modulus)
    yield from adhesion.doubt("the fitted work_of_adhesion", max(work_of_adhesion, 0.0))


def doubts_about_forces(
    *, slope: float, young_modulus: float, most: float = MAX_FORCES_OVER_LOAD
) -> Iterator[str]:
    """Sentences about the force sums of a calibration of threshold or modulus.

    Parameters
    ----------
    slope : float
        Sum of the local forces over the load.
    young_modulus : float
        With which they were found, Pa.
    most : float
        Largest plausible slope, or its inverse.

    Yields
    ------
    str

    Examples
    --------
    >>> list(doubts_about_forces(slope=0.9, young_modulus=3e6))
    []
    """
    if slope > 0 and not 1 / most <= slope <= most:
        yield (
            f"the local forces add up to {slope:.3g} times the load with young_modulus_Pa = "
            f"{young_modulus:g}, plausible is a factor of at most {most:g}; are loads in N, "
            "the modulus in Pa, and pixel_size_m and the radii in metres?"
        )


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
    if loaded["load_N"].nunique() >= FEWEST_LOADS:
        order = loaded["load_N"].rank().corr(loaded["area_m2"].rank())
        if order < 0:
            yield "the area of contact falls as the load grows: is the order of the loads reversed?"
    ratio = float((loaded["force_sum_N"] / loaded["load_N"]).median())
    for slip, unit in SLIPS.items():
        if 1 / SAME_SLIP < ratio / slip < SAME_SLIP:
            yield f"the forces add up to {ratio:.2g} times load_N: were the loads given in {unit}?"
    if scene.indenter is not None and (lens := _other_lens(scene, shown)):
        yield (
            f"{lens}, and [indenter] radius_m = {scene.indenter.radius:.3g}: is that of another lens, or "
            "pixel_size_m not of this camera?"
        )


def _other_lens(scene: Scene, shown: Apex | None) -> str:
    """What the contacts show of the lens, where that is not the stated one; empty where it is."""
    if scene.indenter is None or shown is None or shown.radius is None:
        return ""
    off = abs(shown.radius / scene.indenter.radius - 1)
    differs = off > max(SHOWN_RADIUS, SHOWN_STDS * shown.radius_std / shown.radius)
    return f"the contacts show a lens of {shown.radius:.3g} m" if differs else ""


def warn_of(doubts: Iterable[str], place: str) -> bool:
    """Log doubts about a result that is written; return whether they count, without ``--no-plausibility``."""
    doubts = list(doubts)
    for doubt in doubts:
        logger.warning("%s: %s", place, doubt)
    return bool(doubts) and not _warn_only.get()


def doubts_about_match(
    scene: Scene, *, measured: int, predicted: int, matched: int, shown: Apex | None, spacing: float = np.inf
) -> Iterator[str]:
    """A sentence where measured and predicted contacts are not the same ones, with the likely cause.

    In a dense pattern most contacts of a lens that stands elsewhere are the same ones. Therefore the apex
    that the contacts show decides as well, if it is more than half a spacing away.

    Parameters
    ----------
    scene : Scene
    measured, predicted : int
        Contacts of all frames.
    matched : int
        Those that are measured and predicted.
    shown : Apex or None
        Apex and radius of the lens that the contacts show.
    spacing : float
        Mean distance of the asperities, m.
    """
    causes, wrong = [], 2 * matched < FEWEST_MATCHES * (measured + predicted)
    if shown is not None and scene.indenter is not None:
        apart = float(np.hypot(*np.subtract(shown.place, scene.indenter.apex)))
        if apart > SHOWN_STDS * np.hypot(*shown.std):
            wrong |= apart > spacing / 2
            x, y = shown.place
            causes.append(f"[indenter] apex_m: the contacts show the apex at ({x:.6g}, {y:.6g}) m")
    if lens := _other_lens(scene, shown):
        causes.append(f"[indenter] radius_m: {lens}")
    if not wrong:
        return
    if not 1 / SAME_COUNT <= predicted / max(measured, 1) <= SAME_COUNT:
        more = "more" if predicted > measured else "fewer"
        causes.append(
            f"the load or young_modulus_Pa: {more} contacts are predicted than measured; grams or mN?"
        )
    cause = ", and ".join(causes) or "the apex, [camera] mirrored, rotation_deg or pixel_size_m, or the load"
    yield f"{matched} of {measured} measured and {predicted} predicted contacts match; likely cause: {cause}"


def mean_spacing(asperities: pd.DataFrame) -> float:
    """Mean distance of asperities, m: that of as many on a square lattice over the same box."""
    points = _points(asperities)
    return float(np.sqrt(np.prod(np.ptp(points, axis=0)) / max(len(points), 1)))


def _points(asperities: pd.DataFrame) -> NDArray[np.float64]:
    """Positions, m."""
    return asperities[["x_m", "y_m"]].to_numpy(float)


def _doubts_about_asperities(asperities: pd.DataFrame) -> Iterator[str]:
    """Heights against radii, radii against distances, and single asperities on the other side of zero."""
    height, radius = (float(asperities[name].abs().median()) for name in ("height_m", "radius_m"))
    yield from ASPERITY_RADIUS.doubt("the median of radius_m of the asperities", radius)
    for name, plausible in (("radius_2_m", ASPERITY_RADIUS), ("young_modulus_Pa", YOUNG_MODULUS)):
        if name in asperities and asperities[name].notna().any():
            yield from plausible.doubt(f"the median of {name} of the asperities", asperities[name].median())
    if height > radius:
        yield (
            f"the asperities are taller (median of height_m {height:g} m) than their radius of curvature "
            f"({radius:g} m), more than a hemisphere; are the columns swapped, or in different units?"
        )
    points, spacing = _points(asperities), mean_spacing(asperities)
    if spacing > 0 and radius > MAX_RADIUS_OVER_SPACING * spacing:
        yield (
            f"the radius of the asperities ({radius:g} m) is {radius / spacing:.3g} times their distance "
            f"({spacing:g} m), plausible are at most {MAX_RADIUS_OVER_SPACING:g}; are x_m and y_m in metres?"
        )
    if radius * MAX_SPACING_OVER_RADIUS < spacing:
        yield (
            f"the mean distance of the asperities ({spacing:g} m) is {spacing / radius:.3g} times their "
            f"radius ({radius:g} m), plausible at most {MAX_SPACING_OVER_RADIUS:g}; are they in metres?"
        )
    # few asperities on the other side of zero that stand alone
    for axis, sign in product((0, 1), (-1.0, 1.0)):
        rows = np.flatnonzero(sign * points[:, axis] > 0)
        if 0 < len(rows) <= OPPOSITE_SHARE * len(points):
            apart = np.asarray(cKDTree(np.delete(points, rows, axis=0)).query(points[rows])[0])
            alone = rows[int(np.argmax(apart))]
            if apart.max() > ALONE_SPACINGS * spacing:
                yield (
                    f"asperities: row {alone}, {'xy'[axis]}_m = {points[alone, axis]:g} m lies "
                    f"{apart.max():g} m from the next asperity and has the opposite sign; is the sign right?"
                )


def _doubts_about_places(scene: Scene, asperities: pd.DataFrame) -> Iterator[str]:
    """Apex and camera outside the sample."""
    points = _points(asperities)
    low, high = points.min(axis=0), points.max(axis=0)

    def outside(place: tuple[float, float], factor: float = 1.0) -> float:
        point = factor * np.array(place)
        return float(np.hypot(*np.maximum(np.maximum(low - point, point - high), 0.0)))

    places = {}
    if scene.indenter is not None and "apex" in scene.indenter.model_fields_set:
        places["[indenter] apex_m"] = scene.indenter.apex
    if scene.camera is not None and scene.camera.centre is not None:
        places["[camera] centre_m"] = scene.camera.centre
    for name, place in places.items():
        if outside(place) > MAX_APEX_DISTANCE * float(np.max(high - low)):
            units = [unit for factor, unit in _FACTORS.items() if outside(place, factor) == 0]
            likely = f"; was it given in {units[0]}?" if units else ""
            yield (
                f"{name} = ({place[0]:g}, {place[1]:g}) lies outside the asperities, which reach from "
                f"({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g}) m{likely}"
            )


def _doubts_about_strain(scene: Scene, load: float, half_diagonal: float) -> Iterator[str]:
    """The contact of the smooth sphere against its radius and the sample."""
    if scene.indenter is None or scene.elastic is None or scene.elastic.stated_modulus is None:
        return
    radius, young = scene.indenter.radius, scene.elastic.young_modulus
    modulus = scene.elastic.contact_modulus
    contact = float(hertz.radius(load, sphere_radius=radius, contact_modulus=modulus))
    given = f"load_N = {load:g}, [indenter] radius_m = {radius:g}, young_modulus_Pa = {young:g}"
    hint = "is one of them in another unit (load in mN or grams, mm, MPa)?"
    if contact > MAX_CONTACT_OVER_RADIUS * radius:
        yield (
            f"{given}: a smooth sphere would touch over {contact / radius:.2g} of its radius, beyond "
            f"{MAX_CONTACT_OVER_RADIUS:g} no model holds; {hint}"
        )
    elif contact > MAX_CONTACT_OVER_SAMPLE * half_diagonal:
        yield (
            f"{given}: a smooth sphere would touch over a radius of {contact:g} m, wider than the sample "
            f"({half_diagonal:g} m to its corners); {hint}"
        )
