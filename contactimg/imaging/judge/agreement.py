"""Whether fit and second opinion agree: for each contact, and for all contacts of a frame together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.judge.second_opinion import BLUR_RELATIVE_STD, CHORD_DEFICIT_PX2, SecondOpinion
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.reject.detections import Columns

Values = NDArray[np.float64]

DISAGREEMENT_SIGMA = 3.0
"""Difference of the areas, in standard uncertainties of the second opinion, beyond which a contact disagrees.
False-alarm rate 0.3 % of contacts (theory: normal deviates); on frames as assumed none of 4,000 did, because
the fit shares part of the noise."""
COMMON_SIGMA = 3.5
"""The same for a difference that all contacts share, one of four tests a frame. False-alarm rate: 0.2 %."""
FEWEST_COMMON = 5
"""Contacts that can share a difference. Chosen: fewer are judged one by one."""
MANY_FRACTION, MANY_LEAST = 0.05, 3
"""Fraction and number of contacts that disagree, above which the frame is not ok. Chosen: sixteen times the
false-alarm rate."""
LEAST_RELATIVE = 2e-3
"""Difference of an area that is none, relative to it. Chosen: its blurred edge errs by 1e-3 in height."""
LEAST_SHIFT_PX = 0.01
"""Difference of a radius that is none. Chosen: half the uncertainty of a usual radius."""
UNEXPLAINED_SUM = 1e-3
"""Difference of the sum of the areas that is none, relative to it. Chosen: as the blurred edge errs."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """Differences between second opinion and fit.

    Parameters
    ----------
    difference_px : ndarray, shape (n,)
        Radius of the disk with the area of the second opinion minus the fitted radius: by light or at half
        height, whichever differs more in its uncertainties; NaN without a second opinion.
    disagrees : ndarray of bool, shape (n,)
        Whether it exceeds the errors.
    shared_px : ndarray, shape (n,)
        Difference that all contacts share: the same for all radii, or in proportion to them; 0 if there is
        none.
    first : str
        What the second opinion is compared with.
    """

    difference_px: Values
    disagrees: NDArray[np.bool_]
    shared_px: Values
    first: str = "the fit"

    @property
    def known(self) -> int:
        """Number of contacts with a second opinion."""
        return int(np.count_nonzero(np.isfinite(self.difference_px)))

    @property
    def many(self) -> bool:
        """Whether more contacts disagree than chance explains."""
        count = int(np.count_nonzero(self.disagrees))
        return count >= MANY_LEAST and count > MANY_FRACTION * self.known

    @property
    def is_shared(self) -> bool:
        """Whether all contacts share a difference."""
        return bool(self.shared_px.any())

    def of(self, rows: NDArray[np.bool_]) -> "Agreement":
        """Of some of the contacts."""
        parts = (self.difference_px[rows], self.disagrees[rows], self.shared_px[rows])
        return Agreement(*parts, first=self.first)

    def remark(self, radius_px: Values) -> str:
        """One sentence on what disagrees, with numbers; empty if nothing does."""
        if not (self.many or self.is_shared):
            return ""
        text = ""
        if self.is_shared:
            change = 100.0 * (np.sum((radius_px + self.shared_px) ** 2) / np.sum(radius_px**2) - 1.0)
            text = (
                f"areas measured without a model of the edge differ from those of {self.first} by "
                f"{change:+.2g} % in all contacts alike (radii by {np.median(self.shared_px):+.2g} px); the "
                "uncertainties include that"
            )
        if self.many:
            which = self.disagrees
            differ = (
                f"{np.count_nonzero(which)} of {self.known} contacts have another area without a model of "
                f"the edge (radii by {np.median(self.difference_px[which]):+.2g} px in the median)"
            )
            text = "; ".join(part for part in (text, differ) if part)
        return text


def compare(opinion: SecondOpinion, radius_px: Values, *, blur_px: float) -> Agreement:
    """Compare the second opinion with fitted radii.

    Parameters
    ----------
    opinion : SecondOpinion
    radius_px : ndarray, shape (n,), px
        Of the fit.
    blur_px : float
        Standard deviation of the blurred edge, whose uncertainty all areas at half height share.

    Returns
    -------
    Agreement

    Notes
    -----
    An efficient estimate and any other share the noise of the first, so the variance of their difference is
    the difference of the variances (J. Hausman, Econometrica 46 (1978) 1251, doi:10.2307/1913827, eq. 2.12).
    That of the second opinion alone is therefore an upper limit.
    """
    fitted = np.pi * radius_px**2
    floor = np.maximum(LEAST_RELATIVE * fitted, 2.0 * np.pi * radius_px * LEAST_SHIFT_PX)
    contrast = np.nan_to_num(opinion.common_contrast_std / opinion.common_contrast) * fitted
    blur = np.full(len(fitted), np.hypot(2.0 * np.pi * blur_px**2 * BLUR_RELATIVE_STD, _coarse(blur_px)))
    light = _Comparison(opinion.light_area - fitted, np.hypot(opinion.light_area_std, floor), contrast)
    half_std = np.hypot(np.hypot(opinion.half_area_std, floor), _coarse(blur_px))
    half = _Comparison(opinion.half_area - fitted, half_std, blur)
    pulls = np.stack([light.pulls, half.pulls])
    larger = np.argmax(np.abs(np.nan_to_num(pulls)), axis=0)
    difference = np.where(larger == 0, light.difference, half.difference)
    difference = np.where(np.isnan(difference), half.difference, difference)
    disagrees = np.abs(np.nan_to_num(pulls)).max(axis=0) > DISAGREEMENT_SIGMA
    shared = [test for part in (light, half) for test in part.shared(radius_px)]
    significance, shift = max(shared, key=lambda test: test[0])
    common = shift if significance > COMMON_SIGMA else np.zeros(len(radius_px))
    radius = np.sqrt(np.maximum(fitted + difference, 0.0) / np.pi)
    return Agreement(radius - radius_px, disagrees, common)


def _coarse(blur_px: float) -> float:
    """Uncertainty of an area at half height whose edge is sharper than the pixels, px^2.

    Pixels that are 0 or 1 enclose another area than those that average the light over themselves, by what the
    area at half height is corrected for; of that is left what a blur does not average out.
    """
    wider = max(blur_px**2 - PIXEL_VARIANCE, 0.0) / PIXEL_VARIANCE
    return float((np.pi * PIXEL_VARIANCE + CHORD_DEFICIT_PX2) * np.exp(-wider))


def compare_counted(
    light: tuple[Values, Values], contacts: Columns, *, contrast_relative_std: float
) -> Agreement:
    """Compare the light of contacts with the areas behind the rims that were counted.

    Parameters
    ----------
    light : (ndarray, ndarray), shape (n,), px^2
        Areas by light and their standard uncertainties; NaN where there is no second opinion.
    contacts : dict of arrays
        Columns radius_px, radius_std_px and edge_shift_px of `contactimg.tables.CONTACTS`.
    contrast_relative_std : float
        Relative uncertainty of the contrast of the light, which all contacts share.

    Notes
    -----
    Counting is not efficient: the variances add.
    """
    shift = contacts["edge_shift_px"]
    radius = contacts["radius_px"] - shift
    rim, area = 2.0 * np.pi * radius, np.pi * radius**2
    own = rim * np.sqrt(np.maximum(contacts["radius_std_px"] ** 2 - shift**2, 0.0))
    common = [contrast_relative_std * area, rim * contacts["contrast_shift_px"]]
    # the shift of a threshold goes as the blur to its square at half height, as the blur elsewhere
    common.append(2.0 * BLUR_RELATIVE_STD * rim * shift)
    shared = np.sqrt(np.sum(np.square(common), axis=0))
    std = np.sqrt(light[1] ** 2 + own**2 + shared**2 + (LEAST_RELATIVE * area) ** 2)
    compared = _Comparison(light[0] - area, std, shared)
    disagrees = np.abs(np.nan_to_num(compared.pulls)) > DISAGREEMENT_SIGMA
    significance, change = max(compared.shared(radius), key=lambda test: test[0])
    change = change if significance > COMMON_SIGMA else np.zeros(len(radius))
    difference = np.sqrt(np.maximum(light[0], 0.0) / np.pi) - radius
    return Agreement(difference, disagrees, change, first="the pixel count behind the blur of its rims")


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Differences of areas (px^2), their uncertainties, and the part of these that all contacts share."""

    difference: Values
    std: Values
    shared_std: Values

    @property
    def pulls(self) -> Values:
        """Differences in their uncertainties; NaN where there is no second opinion."""
        return np.asarray(self.difference / self.std)

    def shared(self, radius_px: Values) -> list[tuple[float, Values]]:
        """Significance and shift (px) of all radii: a shift equal in all, and one in proportion to them."""
        known = np.isfinite(self.difference)
        if np.count_nonzero(known) < FEWEST_COMMON:
            return [(0.0, np.zeros(len(radius_px)))]
        difference, std, shared = (part[known] for part in (self.difference, self.std, self.shared_std))
        own = np.sqrt(np.maximum(std**2 - shared**2, 1e-12))
        tests = []
        for shape in (np.ones(len(radius_px)), radius_px):
            # how an area changes with the shift: perimeter, or twice the area for a shift relative to it
            slope = (2.0 * np.pi * radius_px * shape)[known]
            weight = slope / own**2
            total = float(weight @ slope)
            middle = float(np.median(difference / slope)) * slope
            rest = np.clip(difference - middle, -CLIP_SIGMA * own, CLIP_SIGMA * own)
            amplitude = float(weight @ (middle + rest)) / total
            std_amplitude = np.hypot(1.0 / np.sqrt(total), float(weight @ shared) / total)
            floor = UNEXPLAINED_SUM * float(np.sum(np.pi * radius_px[known] ** 2)) / float(slope.sum())
            tests.append((abs(amplitude) / float(np.hypot(std_amplitude, floor)), amplitude * shape))
        return tests


CLIP_SIGMA = 6.0
"""Standard uncertainties from the median beyond which a contact moves the shift of all no further. Chosen."""
