"""Whether contacts are surrounded by an air film: how much of its light their rims show.

The light f of the film, 1 with it and 0 without, is one more quantity that all isolated rims share
(`contactimg.imaging.fit.learned_edge`): its estimate with contrast, blur and whatever families of edges the
frame has shown, and its standard uncertainty s from the scatter between the rims. Where f is neither 0 nor 1
within s, something else shines: the distance to the nearer one counts as uncertainty as well. So does an
error of the height of the edge that all rims share: against the noise of a pixel, averaged over the pixels at
all rims, it may be as significant as the film. The odds of a film by the rims are then those of two normal
distributions about 1 and 0,

    ln odds = (2 f - 1) / (2 s^2).

Before the pixels are looked at, odds are `ODDS` for a contrast that is a film's, and those of the setting for
what was set by hand. A contrast that must have another cause does not exclude a film: it is taken there if
the rims give `TAKEN_ODDS`, and remains possible, with `ODDS` against it, until they exclude it.

What the pixels leave open is an error common to all contacts: the difference of the radii times the square
root of the probability of the other case. What was set by hand is taken, whatever the rims say, and remains
in doubt like any other choice: where they cannot tell, a statement that is wrong is within 2.2 uncertainties.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.imaging.fit.learned_edge import TAKEN_ODDS, EdgeSearch
from contactimg.imaging.fit.problem import RADIUS
from contactimg.imaging.fit.shared_scores import rim_scores
from contactimg.imaging.profile.edge_shape import LIGHT, SHARED
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, FEWEST, NEGLIGIBLE_FRACTION, ROUGH_STD

Values = NDArray[np.float64]

ODDS = 4.0
"""Odds of a film, or of none, before the pixels are looked at. Chosen: where they tell nothing, a wrong
choice is off by at most 1/sqrt(0.2) = 2.2 of the uncertainties that it brings."""
DECIDED_DOUBT = 1.0 / TAKEN_ODDS
"""Probability of the other case below which the rims have decided: it adds a tenth of the difference."""
CONTRAST_FACTOR = 2.0
"""A film explains a contrast within this factor of its own. Chosen by hand; sensitivity not measured."""


@dataclass(frozen=True)
class FilmVerdict:
    """The verdict of the rims of a frame on an air film.

    Parameters
    ----------
    asked : {"on", "off", "auto"}
    taken : bool
        Whether the contacts were measured with a film.
    light, std : float
        Light of the film that all isolated rims show, over that expected, and its standard uncertainty.
    rims : int
        Number of isolated rims.
    doubt : float
        Probability that the choice is wrong.
    area_change : float
        Relative change of the sum of the areas by the other choice.
    """

    asked: str
    taken: bool
    light: float
    std: float
    rims: int
    doubt: float
    area_change: float

    @property
    def part(self) -> float:
        """Part of the difference between the choices that is one standard uncertainty of the radii."""
        return float(np.hypot(self.doubt**0.5, ROUGH_STD if self.taken else 0.0))

    @property
    def contradicted(self) -> bool:
        """Whether the rims speak against what was set by hand."""
        return self.asked != "auto" and self.doubt > 1.0 - DECIDED_DOUBT

    def remark(self) -> str:
        """A sentence about the film; empty where none was found and nothing is left open, or by hand only."""
        rims = f"{self.rims} rims show {self.light:.2g} +- {self.std:.2g} of its light"
        other = "without it" if self.taken else "with it"
        size = "larger" if self.area_change > 0 else "smaller"
        area = f"{other} the area would be {100 * abs(self.area_change):.2g} % {size}"
        if self.contradicted:
            return f'[effects] film = "{self.asked}", but the rims say the opposite ({rims}): {area}'
        if self.doubt > DECIDED_DOUBT:
            what = "assumed" if self.taken else "not assumed"
            reason, advice = "as set", ""
            if self.asked == "auto":
                reason = "as the contrast suggests"
                advice = ': state [effects] film = "on" or "off" if you know'
            return (
                f"the rims cannot tell whether an air film surrounds the contacts ({rims}): it is {what}, "
                f"{reason}, and {area}, of which {self.part:.2g} is part of the uncertainties{advice}"
            )
        return f"an air film surrounds the contacts ({rims}): {area}" if self.taken else ""


@dataclass(frozen=True, eq=False)
class WeighedFilm:
    """The verdict on a film, and the change of all radii with it.

    Parameters
    ----------
    verdict : FilmVerdict
    radius, shift : ndarray, shape (n,), px
        Radii of all contacts without a film, and how they change with it.
    """

    verdict: FilmVerdict
    radius: Values
    shift: Values

    def errors(self, radius: Values) -> Values:
        """Change of radii, as measured by the choice taken, by one standard uncertainty of it."""
        if not len(self.radius):
            return np.zeros(len(radius))
        start, sign = (self.radius + self.shift, -1.0) if self.verdict.taken else (self.radius, 1.0)
        order = np.argsort(start)
        return np.asarray(sign * self.verdict.part * np.interp(radius, start[order], self.shift[order]))


def weigh_film(
    search: EdgeSearch, setting: FilmSetting, families: tuple[str, ...] = ()
) -> WeighedFilm | None:  # fmt: skip
    """Measure the light of the film beside the families of edges that the frame has shown.

    None where a film would change nothing and none is asked for.
    """
    disks, rim = search.joint.fit.disks, setting.rim
    radius = disks[:, RADIUS]
    if setting.asked != "on" and _changes_nothing(rim, radius):
        return None
    rims = search.settle(search.start(replace(search.plain, film=rim)), ("film",))
    if families:  # from what the film explains by itself
        rims = search.settle(rims, (*families, "film"))
    covariance, chosen = rims.step.covariance, rims.step.chosen
    moving = (chosen < SHARED) | (chosen == SHARED + LIGHT)
    chosen = chosen[moving]
    response = rim_scores(search.at(search.joint.contrast), disks, rims.edge.with_light(0.0), chosen).response
    # contrast and blur follow the light along the covariance
    follow = covariance[moving, -1] / max(covariance[-1, -1], 1e-300)
    shift = np.clip(response[:, 1, chosen] @ follow, -0.5 * radius, 0.5 * radius)
    light, std = float(rims.edge.shape[LIGHT]), float(np.sqrt(covariance[-1, -1]))
    pixels = 2.0 * np.pi * float(rims.disks[:, RADIUS].sum()) * 2.0 * EDGE_BLUR_WIDTHS * rims.edge.blur
    # By hand, of the height of an edge: pixels that are not points make 1e-4 of it, and no lens is Gaussian.
    common_sigma = 3e-4 * rims.contrast / search.problem.pixel_noise * np.sqrt(pixels)
    std = float(np.hypot(std * np.hypot(1.0, common_sigma), min(abs(light), abs(1.0 - light))))
    change = float(np.sum((radius + shift) ** 2) / np.sum(radius**2)) - 1.0
    return WeighedFilm(_judge(setting, search.ratio, light, std, len(rims.disks), change), radius, shift)


def _judge(
    setting: FilmSetting, ratio: float, light: float, std: float, rims: int, change: float
) -> FilmVerdict:  # fmt: skip
    """The verdict from the light that the rims show; ``change`` of the areas with a film."""
    asked, data, likely = setting.asked, 0.0, film_makes_contrast(setting.rim, ratio)
    # before the pixels are looked at
    expected = asked == "on" or (asked == "auto" and likely)
    # rims that exclude what was set by hand are heard
    prior_doubt = 1.0 / (1.0 + ODDS) if asked == "auto" else max(setting.doubt, NEGLIGIBLE_FRACTION)
    if rims >= FEWEST:
        data = (light - 0.5) / std**2
    odds = data + float(special.logit(1.0 - prior_doubt)) * (1.0 if expected else -1.0)
    other_cause = asked == "auto" and not likely
    taken = data > np.log(TAKEN_ODDS) if other_cause else odds > 0 if asked == "auto" else asked == "on"
    doubt = float(special.expit(-odds if taken else odds))
    open_choice = asked != "auto" or (other_cause and not taken)
    if open_choice and special.expit(-data if taken else data) > DECIDED_DOUBT:
        doubt = max(doubt, prior_doubt)  # rims that cannot tell do not speak for either case
    change = -change / (1.0 + change) if taken else change
    return FilmVerdict(asked, bool(taken), light, std, rims, doubt, change)


def film_makes_contrast(rim: FilmRim, ratio: float) -> bool:
    """Whether a contrast over the background is that of a film, within `CONTRAST_FACTOR`.

    Examples
    --------
    >>> from contactimg.imaging.profile.film_rim import FilmRim
    >>> from contactimg.optics.film import Light
    >>> rim = FilmRim(Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9)), 1e-4, 1e-6)
    >>> film_makes_contrast(rim, 0.07), film_makes_contrast(rim, 1.2)
    (True, False)
    """
    return bool(1.0 / CONTRAST_FACTOR <= ratio / rim.contrast <= CONTRAST_FACTOR)


def _changes_nothing(rim: FilmRim, radius: Values) -> bool:
    """Whether the light of the film is too little to change areas, from an upper bound at the quartiles."""
    for a in np.quantile(radius, [0.25, 0.75]):
        distance = np.linspace(0.0, max(rim.extent_px(float(a)), 1e-6), 200)
        light = float(np.trapezoid(np.abs(rim.excess(distance, float(a))), distance))
        if 2.0 * light / a > NEGLIGIBLE_FRACTION:
            return False
    return True
