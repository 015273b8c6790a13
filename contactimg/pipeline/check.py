"""Does the measurement hold on these frames? Contacts of known radius are drawn into them and measured again.

Each frame is measured as `process` does. Contacts with the blur, the edge, the contrast and the spread of
contrasts that it shows are drawn into places that its own contacts leave free, and the frame is measured
again. How many of the drawn contacts are found, how far their radii are off, and how often the stated
uncertainties hold, is known from that by their radius.
"""

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactimg.errors import FrameError
from contactimg.files import Experiment
from contactimg.frame import Frame
from contactimg.imaging.kernels.radial_sums import add_profiles
from contactimg.imaging.measure import ImageMeasurement
from contactimg.imaging.pixels.masks import clear_disks
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.edge_shape import Edge, Nodes
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS
from contactimg.pipeline.each_frame import for_each_frame, measured_and_failed
from contactimg.pipeline.frame import FrameOptions, film_setting, measure_prepared
from contactimg.pipeline.inputs import asperities_and_sites
from contactimg.tables import CHECK, DRAWN

FOUND = 0.9
"""Share of the drawn contacts from which a class counts as found, in the sentence."""


@dataclass(frozen=True, eq=False)
class MeasurementCheck:
    """The fate of the contacts that were drawn into the frames of an experiment.

    Parameters
    ----------
    drawn : DataFrame
        One row a drawn contact, columns of `contactimg.tables.DRAWN`.
    classes : DataFrame
        One row a class of radii, columns of `contactimg.tables.CHECK`.
    sentence : str
        What they say.
    failed : DataFrame
        frame and message of those that could not be checked.
    """

    drawn: pd.DataFrame
    classes: pd.DataFrame
    sentence: str
    failed: pd.DataFrame


def check_experiment(experiment: Experiment, *, seed: int = 1) -> MeasurementCheck:
    """Draw contacts of known radius into the frames of an experiment, and measure them again.

    Parameters
    ----------
    experiment : Experiment
    seed : int
        Of the random radii, brightnesses and places.

    Returns
    -------
    MeasurementCheck
        Each frame is measured twice. Drawn contacts have no air film, and each frame is measured alone, as
        `process` does before the frames of a series help each other.

    Raises
    ------
    InputError
        If no frame shows a contact, whose contrast and blur are needed; the message gives the first reason.
    """
    _, sites = asperities_and_sites(experiment)
    options = FrameOptions(experiment.scene, film_setting(experiment.scene, sites))
    call = partial(_check_frame, options=options, seed=seed)
    results = for_each_frame(experiment, call, shown="checking frames")
    nothing = "no frame shows contacts like which others could be drawn"
    tables, failed = measured_and_failed(results, nothing)
    drawn = DRAWN.joined(table for table, _ in tables)
    classes = summarise_drawn(drawn, count=8)  # chosen
    sentence = _sentence(drawn, classes, float(pd.Series([limit for _, limit in tables]).median()))
    return MeasurementCheck(drawn, classes, sentence, pd.DataFrame(failed, columns=["frame", "message"]))


def summarise_drawn(drawn: pd.DataFrame, *, count: int) -> pd.DataFrame:
    """Completeness, errors and coverage by so many classes of the true radius: `contactimg.tables.CHECK`."""
    radius, error = drawn["radius_px"], drawn["measured_px"] - drawn["radius_px"]
    edges = np.geomspace(radius.min() * (1 - 1e-9), radius.max() * (1 + 1e-9), count + 1)
    apart, missed = error.abs() / drawn["measured_std_px"], drawn["found"] == 0
    columns = {"completeness": drawn["found"], "bias_px": error, "rms_px": error**2}
    columns |= {f"within_{n}_std": apart.le(n).astype(float).mask(missed) for n in (1, 2)}
    classes = np.searchsorted(edges, radius) - 1
    table = pd.DataFrame(columns).groupby(classes).mean()
    counts = drawn.groupby(classes)["found"].agg(drawn="size", found="sum")
    low, high = edges[table.index], edges[table.index + 1]
    places = {"low_px": low, "high_px": high, "radius_px": np.sqrt(low * high)}
    return CHECK.conform(table.join(counts).assign(**places, rms_px=np.sqrt(table["rms_px"])))


def _sentence(drawn: pd.DataFrame, classes: pd.DataFrame, stated_px: float) -> str:
    """The sentence that the check says; ``stated_px`` is the detection limit of the frames."""
    share = classes["completeness"].to_numpy()
    first = int(np.max(np.flatnonzero(share < FOUND), initial=-1)) + 1
    if first == len(classes):
        return f"fewer than {100 * FOUND:.0f} % of the drawn contacts are found, whatever their radius"
    low = classes["low_px"].iloc[first]
    large = summarise_drawn(drawn[drawn["radius_px"] > low], count=1).iloc[0]
    scatter = np.sqrt(max(large["rms_px"] ** 2 - large["bias_px"] ** 2, 0.0) / large["found"])
    limit = ""
    if share[0] < 0.5:
        half = np.exp(np.interp(0.5, np.maximum.accumulate(share), np.log(classes["radius_px"])))
        limit = f"; half of those of {half:.2g} px are found, the frames state {stated_px:.2g} px"
    return (
        f"of {len(drawn)} contacts drawn into the frames, {100 * large['completeness']:.0f} % of those "
        f"above {low:.2g} px in radius are found; their radii are off by {large['bias_px']:+.2g} ± "
        f"{scatter:.1g} px in the mean and {large['rms_px']:.2g} px root mean square; stated uncertainties "
        f"hold {100 * large['within_1_std']:.0f} and {100 * large['within_2_std']:.0f} % (68 and 95 "
        f"expected){limit}"
    )


def _check_frame(
    frame: Frame, reference: NDArray | None, *, options: FrameOptions, seed: int
) -> tuple[pd.DataFrame, float]:
    """The contacts drawn into one frame as they were found, and the detection limit that it states, px."""
    before = measure_prepared(frame, reference, options.scene, film=options.film)
    if not len(before.disks):
        raise FrameError(before.message or "no contact")
    rng = np.random.default_rng([seed, *frame.name.encode()])
    disks = _choose(before, rng)
    if not len(disks):
        raise FrameError(f"{frame.name}: the contacts leave no place free for others")
    drawn = replace(frame, image=draw_contacts(frame.image, before, disks, rng))
    after = measure_prepared(drawn, reference, options.scene, film=options.film).disks
    table = pd.DataFrame(disks, columns=["x_px", "y_px", "radius_px", "contrast"]).assign(frame=frame.name)
    # the nearest measured contact, within 1.5 px or half the radius of the drawn one
    reach = np.maximum(1.5, 0.5 * disks[:, 2])
    distance, nearest = cKDTree(after[["x_px", "y_px"]].to_numpy(float).reshape(-1, 2)).query(disks[:, :2])
    found = distance < reach
    measured = after[["radius_px", "radius_std_px"]].reindex(np.where(found, nearest, -1))
    table[["measured_px", "measured_std_px"]] = measured.to_numpy(float)
    return table.assign(found=found.astype(int)), before.smallest_px


def _blur(measurement: ImageMeasurement) -> float:
    """Standard deviation of the blur, pixel included, px; that of a pixel's own where none is known."""
    blur = measurement.blur_px
    return float(np.hypot(blur if np.isfinite(blur) else 1.0, PIXEL_VARIANCE**0.5))


def _choose(measurement: ImageMeasurement, rng: np.random.Generator) -> NDArray[np.float64]:
    """Places, radii and contrasts (grey levels) of contacts to draw, shape (n, 4)."""
    columns = ["x_px", "y_px", "radius_px"]
    own, others = (one[columns].dropna().to_numpy(float) for one in (measurement.disks, measurement.rejected))
    blur, spread = _blur(measurement), np.nan_to_num(measurement.optics.spread)
    # from contacts that no frame shows to at least those that show their plateau
    smallest, largest = 0.3 * blur, max(float(np.quantile(own[:, 2], 0.95)), 6.0 * blur)
    count = int(np.clip(0.25 * len(own), 8, 60))  # by hand: they do not make another frame of it
    radii = np.exp(rng.uniform(np.log(smallest), np.log(largest), count))
    valid = measurement.foreground.frame_pair.valid
    free = np.ones(measurement.difference.shape, np.uint8) if valid is None else valid.astype(np.uint8)
    clear_disks(free, np.vstack([own, others]))
    chosen = list[list[float]]()
    for radius in np.sort(radii)[::-1].tolist():  # the widest find room first
        distance = cv2.distanceTransform(np.pad(free, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        places = np.flatnonzero(distance > radius + CLEAR_BLUR_WIDTHS * blur + 1.0)
        if len(places):
            row, column = divmod(int(rng.choice(places)), free.shape[1])
            x, y = column + rng.uniform(-0.5, 0.5), row + rng.uniform(-0.5, 0.5)
            chosen.append([x, y, radius, rng.normal(measurement.contrast, spread)])
            clear_disks(free, np.array([chosen[-1]]))
    return np.array(chosen).reshape(-1, 4)


def draw_contacts(
    image: NDArray, measurement: ImageMeasurement, disks: NDArray[np.float64], rng: np.random.Generator
) -> NDArray:
    """A frame with further contacts that have the edge its own contacts show.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels.
    measurement : ImageMeasurement
        Of it.
    disks : ndarray, shape (n, 4)
        x, y, radius (px) and contrast (grey levels at the mean light; negative for dark contacts).
    rng : numpy.random.Generator
        Of the noise that the light of the contacts adds, and of rounding.

    Returns
    -------
    ndarray
        Of the type of ``image``.
    """
    difference, level = measurement.foreground.difference, max(abs(measurement.level), 1.0)
    knowledge = measurement.own_optics.edge
    edge = Edge.plain(_blur(measurement), measurement.contrast / level)
    if knowledge is not None:
        blur = knowledge.blur_px if "point spread" in knowledge.families else edge.blur
        edge = replace(edge, blur=blur, shape=knowledge.shape)
    nodes, light = Nodes.about(disks, image.shape, edge.blur), np.zeros(image.shape, np.float32)
    add_profiles(light, disks, nodes.inner, edge.profile(nodes), nodes.step)
    if difference.level > 0 and (difference.ratio or np.ptp(difference.brightness) > 0):
        # contacts transmit a fraction of the light that falls on them
        light *= _local_light(image) / np.float32(measurement.level)
    touched = light != 0.0
    more = measurement.noise**2 / 2.0 * np.maximum(light[touched], 0.0) / level
    light[touched] += rng.normal(0.0, np.sqrt(more))
    if image.dtype.kind == "f":
        return (image + light).astype(image.dtype)
    light[touched] += rng.uniform(-0.5, 0.5, more.size)
    pair = measurement.foreground.frame_pair
    most = min(float(np.iinfo(image.dtype).max), pair.full_scale * pair.unit)
    return np.where(touched, np.clip(np.rint(image + light), 0, most), image).astype(image.dtype)


def _local_light(image: NDArray) -> NDArray[np.float32]:
    """Mean light around each pixel, of every other row and column: a colour mosaic remains one."""
    light = np.nan_to_num(image.astype(np.float32))
    for y, x in np.ndindex(2, 2):
        # by hand: so large is the smallest free place
        light[y::2, x::2] = cv2.blur(np.ascontiguousarray(light[y::2, x::2]), (5, 5))
    return light
