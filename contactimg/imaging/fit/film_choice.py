"""Whether contacts are surrounded by an air film: how much of its light their rims show.

The light f of the film, 1 with it and 0 without, is one more quantity that all isolated rims share
(`contactimg.imaging.fit.edge_scores`): its estimate with contrast, blur and whatever families of edges the
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

from contactimg.imaging.fit.edge_scores import (
    FEW_CONTACTS,
    FILM,
    Edge,
    EdgeScores,
    Placement,
    edge_prior,
    evenly,
    isolated_disks,
    parameters_of,
)
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.imaging.profile.limits import (
    EDGE_BLUR_WIDTHS,
    FEWEST,
    NEGLIGIBLE_FRACTION,
    ROUGH_STD,
    SETTLED_SIGMA,
)

Values = NDArray[np.float64]

ODDS = 4.0
"""Odds of a film, or of none, before the pixels are looked at. Chosen: where they tell nothing, a wrong
choice is off by at most 1/sqrt(0.2) = 2.2 of the uncertainties that it brings."""
TAKEN_ODDS = 100.0
"""Odds by the rims at which a film is taken where the contrast is not its own. Chosen: a film that is not
there is drawn in one such frame of a hundred; what is not taken remains in the uncertainties."""
DECIDED_DOUBT = 0.02
"""Probability of the other case below which the rims have decided. Chosen: it adds a tenth of the
difference."""
LEAST_DOUBT = 1e-4
"""Probability that what was set by hand is a mistake, at least. Chosen: rims that exclude it are heard, and
it adds a hundredth of the difference."""
CONTRAST_FACTOR = 2.0
"""A film explains a contrast within this factor of its own. Chosen by hand; sensitivity not measured."""
LARGEST_LOG_ODDS = 50.0
"""Logarithm of the odds by rims at most. Accuracy: beyond, probabilities are rounded."""
MODEL_ERROR = 3e-4
"""Error of the height of an edge, of the contrast, that all rims share. By hand: pixels that are not points
make 1e-4 at a blur of 1.4 px, and no lens has a Gaussian point spread function."""
MOST_STEPS = 20
"""Newton steps of the rims at most. Accuracy."""


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
        other, size = (
            "without it" if self.taken else "with it",
            "larger" if self.area_change > 0 else "smaller",
        )
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
class Rims:
    """The quantities that isolated rims share at the maximum of their likelihood.

    Parameters
    ----------
    edge : Edge
    covariance, own_covariance : ndarray, shape (2 + k, 2 + k)
        Of ln C, the blur, parameters of the edge and, where it is free, the light of the film, the last; with
        prior knowledge, and without.
    count : int
        Number of rims.
    common_sigma : float
        Significance of an error of `MODEL_ERROR` that all rims share, standard deviations.
    """

    edge: Edge
    covariance: Values
    own_covariance: Values
    count: int
    common_sigma: float


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


@dataclass(frozen=True, eq=False)
class FilmTrial:
    """A frame in which a film is looked for.

    Parameters
    ----------
    problem : FitProblem
    joint : JointFit
        Of it, with the plain edge.
    optics_prior : OpticsPrior
    placement : Placement
    setting : FilmSetting
    likely : bool
        Whether the contrast is that of a film.
    """

    problem: FitProblem
    joint: JointFit
    optics_prior: OpticsPrior
    placement: Placement
    setting: FilmSetting
    likely: bool

    def weigh(self, families: tuple[str, ...] = ()) -> WeighedFilm | None:
        """Measure the light of the film beside the families of edges that the frame has shown.

        None where a film would change nothing and none is asked for.
        """
        disks, rim = self.joint.fit.disks, self.setting.rim
        if self.setting.asked != "on" and _changes_nothing(rim, disks[:, RADIUS]):
            return None
        rims = self.settle(replace(Edge.plain(self.joint.fit.blur), film=rim), free=True)
        if families:  # from what the film explains by itself
            rims = self.settle(rims.edge, families, free=True)
        dark, problem = replace(rims.edge, light=0.0), replace(self.problem, prior=self.joint.prior)
        moving = np.array([0, 1, FILM])
        response = EdgeScores.expected(problem, disks, dark, self.placement, moving).response[:, moving]
        # contrast and blur follow the light along the covariance
        follow = np.append(rims.covariance[:2, -1] / max(rims.covariance[-1, -1], 1e-300), 1.0)
        radius = disks[:, RADIUS]
        shift = np.clip(response @ follow, -0.5 * radius, 0.5 * radius)
        return WeighedFilm(self._verdict(rims, radius, shift), radius, shift)

    def settle(self, edge: Edge, families: tuple[str, ...] = (), *, free: bool) -> Rims:
        """The maximum of the likelihood of the isolated rims from an edge on; ``free``: the light as well.

        Each rim has a radius, a contrast and a background of its own.
        """
        fit, problem = self.joint.fit, replace(self.problem, prior=self.joint.prior)
        every_rim = fit.disks[isolated_disks(problem, fit.disks, blur=fit.blur)]
        disks = evenly(every_rim, FEW_CONTACTS)  # until they have settled, for time
        chosen = np.union1d([0, 1], parameters_of(families))
        chosen = np.append(chosen, FILM) if free else chosen
        last, share = np.zeros(len(chosen)), 1.0
        covariance = own_covariance = np.diag([1.0, fit.blur**2, *np.ones(len(chosen) - 2)])
        most = min(problem.largest_contrast, problem.shown_contrast)
        for _ in range(MOST_STEPS):
            scores = EdgeScores.of(problem, disks, edge, self.placement, chosen)
            disks = disks[scores.kept]
            if not len(disks):
                break
            score, information = edge_prior(edge, self.optics_prior, problem.prior.mean)
            own_covariance = scores.step(chosen, (0.0 * score, 1e-9 * information)).covariance
            step = scores.step(chosen, (score, information))
            back = last @ np.linalg.solve(step.covariance, step.delta) < 0.0
            share = 0.5 * share if back else 1.0  # steps that go to and fro become shorter
            delta, covariance = share * step.delta, step.covariance
            beyond = max(delta[0] - np.log(most / problem.prior.mean), 0.0)
            delta -= beyond * covariance[:, 0] / covariance[0, 0]  # the others follow a contrast at its limit
            moved = edge.moved(chosen, delta)
            delta[1:] = (moved.shared - edge.shared)[chosen[1:]]
            edge, last = moved, delta
            own, disks = scores.own_step + scores.own_response[:, :, chosen] @ delta, disks.copy()
            radius, contrast = disks[:, RADIUS], disks[:, CONTRAST]
            disks[:, RADIUS] = np.clip(radius + own[:, 1], 0.6 * radius, 1.5 * radius)
            disks[:, CONTRAST] = np.clip(contrast + own[:, 0], 0.5 * contrast, 2.0 * contrast)
            problem = replace(problem, prior=problem.prior.at(problem.prior.mean * float(np.exp(delta[0]))))
            far = float(np.max(np.abs(own[:, 1]) / scores.radius_std))
            if delta @ np.linalg.solve(covariance, delta) < SETTLED_SIGMA**2 and far < 0.5:
                if len(every_rim) <= FEW_CONTACTS:
                    break
                disks, every_rim = every_rim, every_rim[:0]
        pixels = 2.0 * np.pi * float(disks[:, RADIUS].sum()) * 2.0 * EDGE_BLUR_WIDTHS * edge.blur
        common_sigma = MODEL_ERROR * problem.prior.mean / problem.pixel_noise * np.sqrt(pixels)
        return Rims(edge, covariance, own_covariance, len(disks), float(common_sigma))

    def _verdict(self, rims: Rims, radius: Values, shift: Values) -> FilmVerdict:
        """The verdict from the light that the rims show."""
        asked, light, data = self.setting.asked, rims.edge.light, 0.0
        # before the pixels are looked at
        expected = asked == "on" or (asked == "auto" and self.likely)
        prior_doubt = 1.0 / (1.0 + ODDS) if asked == "auto" else max(self.setting.doubt, LEAST_DOUBT)
        std = float(np.sqrt(rims.covariance[-1, -1])) * np.hypot(1.0, rims.common_sigma)
        std = float(np.hypot(std, min(abs(light), abs(1.0 - light))))
        if rims.count >= FEWEST:
            data = float(np.clip((light - 0.5) / std**2, -LARGEST_LOG_ODDS, LARGEST_LOG_ODDS))
        odds = data + float(special.logit(1.0 - prior_doubt)) * (1.0 if expected else -1.0)
        other_cause = asked == "auto" and not self.likely
        taken = data > np.log(TAKEN_ODDS) if other_cause else odds > 0 if asked == "auto" else asked == "on"
        doubt = float(special.expit(-odds if taken else odds))
        open_choice = asked != "auto" or (other_cause and not taken)
        if open_choice and special.expit(-data if taken else data) > DECIDED_DOUBT:
            doubt = max(doubt, prior_doubt)  # rims that cannot tell do not speak for either case
        with_film = float(np.sum((radius + shift) ** 2) / np.sum(radius**2))
        change = 1.0 / with_film - 1.0 if taken else with_film - 1.0
        return FilmVerdict(asked, bool(taken), light, std, rims.count, doubt, change)


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
