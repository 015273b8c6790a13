"""Contacts of runs by asperity: the table with upper limits from the images, and laws under shear."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.area_power_law import group_loads
from contactimg.analysis.estimates import Estimate
from contactimg.files.runs import frame_shift
from contactimg.frame import Frame
from contactimg.pipeline.analyse.places import Place, fit_or_note
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame
from contactimg.pipeline.frame import count_pixels
from contactimg.shear.followed import ShearLaws, fit_beta, fit_shear_laws, follow_contacts
from contactimg.shear.laws import RateLaw, fit_strength
from contactimg.shear.unseen import limit_radii
from contactimg.tables import FOLLOWED, Schema

logger = logging.getLogger(__name__)

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sheared:
    """Contacts by asperity, and what they do under a tangential load.

    Parameters
    ----------
    followed : DataFrame
        Columns of `contactimg.tables.FOLLOWED`; empty where contacts have no asperities.
    laws : tuple of ShearLaws
        One a place and normal load that has tangential loads.
    beta : RateLaw or None
    """

    followed: pd.DataFrame
    laws: tuple[ShearLaws, ...] = ()
    beta: RateLaw | None = None

    def rows(self) -> Iterator[tuple[str, Estimate, str, str, int]]:
        """Quantity, its estimate, unit, note and number of points, for results.csv."""
        for law in self.laws:
            total, at, count = law.total, f" at P = {law.load:.4g} N", law.total.n_points
            yield "shear_area", total.start, "m2", "A0 of A = A0 - alpha Q^2, sum of the contacts" + at, count
            yield "shear_area_rate", total.rate, "m2/N2", "alpha of the sum" + at, count
            for name, axis in (("along", law.along), ("across", law.across)):
                if axis is not None:
                    note = f"k of a0 - k Q^2, mean half-axis {name} Q{at}"
                    yield f"shear_axis_{name}_rate", axis.rate, "m/N2", note, count
            if total.start.value > total.rate.value * law.largest**2:
                note = f"Q/A(Q) of the largest tangential load: sigma, if the contact slides there{at}"
                yield "shear_strength_at_largest", fit_strength(total, law.largest), "Pa", note, count
        if self.beta is not None:
            beta, exponent, count = self.beta.beta, self.beta.exponent, self.beta.n_points
            note = "of single contacts, alpha = beta A0^(-3/2); loads shared as the areas"
            yield "shear_beta", beta, "m5/N2", note, count
            if np.isfinite(exponent.value):
                yield "shear_rate_exponent", exponent, "1", "the same with a free exponent", count

    def table(self) -> tuple[Schema, pd.DataFrame]:
        """The table asperities.csv, with the column ``place`` where there are several."""
        schema = FOLLOWED if (self.followed["place"] != "").any() else FOLLOWED.and_later()
        return schema, self.followed[list(schema.columns)]


def analyse_shear(places: Sequence[Place], notes: list[str], *, load_tolerance: float) -> Sheared:
    """The contacts of places by asperity, and their laws; what cannot be fitted is added to the notes.

    Upper limits need the images: frames in which some asperity of the table does not touch are read again
    from the folder that the run names. Where they are gone, the limit is the detection limit of the frame.
    """
    tables, laws = list[pd.DataFrame](), list[ShearLaws]()
    for place in places:
        if place.asperities is None or not place.contacts["asperity"].notna().any():
            if place.loads["tangential_N"].notna().any():
                notes.append(f"{place.name}: no laws under shear: no contact has an asperity")
            continue
        table = follow_contacts(place.contacts, place.frames, place.loads, place.asperities)
        table = table.assign(radius_upper_m=_upper_limits(place, table))
        tables.append(table if len(places) == 1 else table.assign(place=place.name))
        if not place.loads["tangential_N"].any():
            continue
        still = place.loads.loc[~(place.loads["velocity_m_s"].abs() > 0), "frame"]
        resting = table[table["frame"].isin(still) & table["tangential_N"].notna() & table["load_N"].notna()]
        direction = place.scene.load.tangential_direction
        angle = direction if place.pose is None else float(place.pose.angle_in_image(direction))
        groups = resting.groupby(group_loads(resting["load_N"].to_numpy(float), tolerance=load_tolerance))
        why = [f"{place.name}: no laws under shear: no frame at rest has a normal and a tangential load"]
        fit = partial(fit_or_note, why, place.name, fit_shear_laws, frames=place.frames, direction=angle)
        own = [law for _, part in groups if (law := fit(part)) is not None]
        laws += own
        if not own:
            notes.append(why[-1])
        elif all(law.along is None for law in own):
            cure = 'process with [measure] shape = "ellipse"'
            notes.append(f"{place.name}: no law of half-axes: no contact is an ellipse in all frames; {cure}")
    followed = FOLLOWED.joined(tables)
    beta = fit_or_note(notes, "beta", fit_beta, laws) if laws else None
    return Sheared(followed, tuple(laws), beta)


def _upper_limits(place: Place, table: pd.DataFrame) -> Values:
    """Upper limit of the radius in each row without a contact, m; NaN in the others and outside the image."""
    limits = np.full(len(table), np.nan)
    if place.pose is None:
        return limits
    pixel, experiment = place.pose.pixel_size, place.experiment
    shots = place.frames.set_index("frame")[["contrast", "blur_px", "detection_limit_px"]].astype(float)
    sources = {} if experiment is None else {source.name: source for source in experiment.frames}
    known = dict(list(place.contacts.groupby("frame")[["x_px", "y_px", "radius_px"]]))
    jobs, rows = [], []
    for frame, part in table.reset_index()[~table["touches"].to_numpy()].groupby("frame"):
        name, index = str(frame), part.index.to_numpy()
        spots = np.column_stack(place.pose.to_pixels(part["x_m"], part["y_m"]))
        spots += frame_shift(place.frames, name)
        shape = np.array(place.pose.shape)[::-1]
        shown = ((spots > -0.5) & (spots < shape - 0.5)).all(axis=1)
        contrast, blur, detected = (float(number) for number in shots.loc[name].to_numpy(float))
        limits[index[shown]] = pixel * detected
        if name in sources and np.isfinite(contrast) and np.isfinite(blur):
            own = known[name].to_numpy(float) if name in known else np.empty((0, 3))
            jobs.append((sources[name], spots, own, {"contrast": abs(contrast), "blur_px": blur}))
            rows.append(index)
    if experiment is None:
        return limits
    scene = experiment.scene

    def unseen(
        frame: Frame, reference: NDArray | None, spots: Values, contacts: Values, numbers: dict[str, float]
    ) -> Values:
        """Limits of the radii at the spots of a frame; the cheaper count subtracts the same background."""
        seen = count_pixels(frame, reference, scene).foreground
        image, valid = seen.image * np.float32(seen.frame_pair.unit), seen.frame_pair.valid
        return limit_radii(image, spots, contacts=contacts, **numbers, valid=valid)

    measured = for_each_frame(experiment, unseen, jobs, shown="looking for contacts not seen")
    for index, found in zip(rows, measured, strict=True):
        if isinstance(found, FailedFrame):
            logger.warning("limits of contacts are those of detection: %s", found.row["message"])
        else:
            limits[index] = pixel * found
    return limits
