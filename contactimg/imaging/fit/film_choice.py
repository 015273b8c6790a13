"""Whether contacts are surrounded by an air film: the likelihoods of all isolated rims with it and without.

Each rim has a difference of log-likelihoods, film minus none. Their sum over its uncertainty, from the
scatter between the rims, gives the odds (Vuong, Econometrica 57 (1989) 307, doi:10.2307/1912557, who compares
models of which neither need be true), but never more than the ratio of the likelihoods itself. Both have the
same number of parameters; an edge learned from the frame pays one unit of log-likelihood for each of its own
(Akaike). Before the pixels are looked at, odds are `ODDS` for a contrast that is a film's, and those of the
setting for what was set by hand. A contrast that must have another cause does not exclude a film: it is taken
there if the rims give `TAKEN_ODDS`, and remains possible, with `ODDS` against it, until they exclude it.

What the pixels leave open is an error common to all contacts: the difference of the radii times the square
root of the probability of the other case. What was set by hand is taken, whatever the rims say, and remains
in doubt like any other choice: where they cannot tell, a statement that is wrong is within 2.2 uncertainties.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from contactimg.imaging.fit.edge_profile import EdgeFit
from contactimg.imaging.fit.edge_scores import (
    EVERY_TEMPLATE,
    FINE_STEPS_PER_BLUR,
    INNER_BLUR_WIDTHS,
    Edge,
    EdgeScores,
    Placement,
    isolated_disks,
)
from contactimg.imaging.fit.problem import RADIUS, FitProblem, touches
from contactimg.imaging.fit.rim_likelihood import RimFit, RimRatios, compare_rims, fit_rims
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior
from contactimg.imaging.kernels.radial_sums import add_profiles, radial_nodes
from contactimg.imaging.profile.edge_shape import (
    BlurredDisks,
    PlacedDisks,
    blurred_profile,
    edge_templates,
    look_up,
)
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting, film_table

BLUR_STEP = 0.02  # of the logarithm of the blur in its derivative; accuracy
Values = NDArray[np.float64]
EdgeAt = Callable[[float], Edge]

ODDS = 4.0
"""Odds of a film, or of none, before the pixels are looked at. Chosen: where they tell nothing, a wrong
choice is off by at most 1/sqrt(0.2) = 2.2 of the uncertainties that it brings."""
TAKEN_ODDS = 100.0
"""Odds by the rims at which a film is taken where the contrast is not its own. Chosen: a film that is not
there is drawn in one such frame of a hundred; what is not taken remains in the uncertainties."""
FILM_RELATIVE_STD = 0.1
"""Standard uncertainty of the light of a film that is drawn. Chosen: indices, lamp and radius of the summits
are known to some per cent each; sums of areas of frames as assumed are off by 0.07 of the difference."""
DECIDED_DOUBT = 0.02
"""Probability of the other case below which the rims have decided. Chosen: it adds a tenth of the
difference."""
LEAST_DOUBT = 1e-4
"""Probability that what was set by hand is a mistake, at least. Chosen: rims that exclude it are heard, and
it adds a hundredth of the difference."""
CONTRAST_FACTOR = 2.0
"""A film explains a contrast within this factor of its own. Chosen by hand; sensitivity not measured."""
LEAST_AREA_CHANGE = 1e-4
"""Relative change of the areas below which a film is not looked for. Chosen: far below any uncertainty."""
FEWEST_RIMS = 3
"""Rims whose scatter gives the uncertainty of their sum. Theory: two degrees of freedom."""


@dataclass(frozen=True)
class FilmVerdict:
    """What the rims of a frame say of an air film.

    Parameters
    ----------
    asked : {"on", "off", "auto"}
    taken : bool
        Whether the contacts were measured with a film.
    log_likelihood, std : float
        With a film minus without, over all isolated rims, and its standard uncertainty.
    rims : int
        Number of isolated rims.
    doubt : float
        Probability that the choice is wrong.
    area_change : float
        Relative change of the sum of the areas by the other choice.
    """

    asked: str
    taken: bool
    log_likelihood: float
    std: float
    rims: int
    doubt: float
    area_change: float

    @property
    def share(self) -> float:
        """Part of the difference between the choices that is one standard uncertainty of the radii."""
        return float(np.hypot(self.doubt**0.5, FILM_RELATIVE_STD if self.taken else 0.0))

    @property
    def contradicted(self) -> bool:
        """Whether the rims speak against what was set by hand."""
        return self.asked != "auto" and self.doubt > 1.0 - DECIDED_DOUBT

    def remark(self) -> str:
        """What to say of it; empty where no film was found and nothing is left open, or by hand only."""
        rims = f"{self.rims} rims: log-likelihood {self.log_likelihood:+.3g} +- {self.std:.2g} with it"
        other = "without it" if self.taken else "with it"
        area = f"{other} the area would be {100 * abs(self.area_change):.2g} % "
        area += "larger" if self.area_change > 0 else "smaller"
        if self.contradicted:
            return f'[effects] film = "{self.asked}", but the rims say the opposite ({rims}): {area}'
        if self.doubt > DECIDED_DOUBT:
            what = "assumed" if self.taken else "not assumed"
            undecided = (
                f"the rims cannot tell whether an air film surrounds the contacts ({rims}): it is {what}"
            )
            reason = "as the contrast suggests" if self.asked == "auto" else "as set"
            advice = ': state [effects] film = "on" or "off" if you know' if self.asked == "auto" else ""
            part = f"of which {self.share:.2g} is part of the uncertainties"
            return f"{undecided}, {reason}, and {area}, {part}{advice}"
        return f"an air film surrounds the contacts ({rims}): {area}" if self.taken else ""


@dataclass(frozen=True, eq=False)
class WeighedFilm:
    """The verdict, and what it takes to act on it.

    Parameters
    ----------
    verdict : FilmVerdict
    film : RimFit
        Rims with the film at its best blur.
    radius, shift : ndarray, shape (n,), px
        Radii of all contacts without a film, and how they change with it.
    rim : FilmRim
    """

    verdict: FilmVerdict
    film: RimFit
    radius: Values
    shift: Values
    rim: FilmRim

    def errors(self, radius: Values) -> Values:
        """Change of radii, as measured by the choice taken, by one standard uncertainty of it."""
        start = self.radius + (self.shift if self.verdict.taken else 0.0)
        order = np.argsort(start)
        if not len(order):
            return np.zeros(len(radius))
        sign = -1.0 if self.verdict.taken else 1.0
        step = np.interp(radius, start[order], self.shift[order])
        return np.asarray(sign * self.verdict.share * step)


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

    def weigh(self) -> WeighedFilm | None:
        """Compare the likelihoods; None where a film would change nothing and none is asked for."""
        problem, disks, rim = self._problem, self.joint.fit.disks, self.setting.rim
        blur = self.joint.fit.blur
        if self.setting.asked != "on" and _changes_nothing(rim, disks[:, RADIUS]):
            return None
        plain, film = (self._fit(edge_at) for edge_at in (Edge.plain, self._film_at))
        direction = FilmDirection.of(blur, rim)
        expected = EdgeScores.expected(problem, disks, direction, self.placement)
        moved = np.array(
            [np.log(film.problem.contrast / plain.problem.contrast), film.edge.blur - plain.edge.blur, 1.0]
        )
        radius = disks[:, RADIUS]
        shift = np.clip(expected.response @ moved, -0.5 * radius, 0.5 * radius)
        ratios = compare_rims(film, plain, self.placement)
        return WeighedFilm(self._verdict(ratios, radius, shift), film, radius, shift, rim)

    def against(self, weighed: WeighedFilm, learned: EdgeFit) -> WeighedFilm:
        """Compare the film with an edge that was learned from the frame instead of with the plain one."""
        edge = learned.learned.edge
        rival = self._fit(lambda blur: Edge(blur, edge.shape), edge.blur)
        ratios = compare_rims(weighed.film, rival, self.placement)
        cost = float(np.count_nonzero(edge.shape))
        verdict = self._verdict(ratios, weighed.radius, weighed.shift, cost=cost)
        return replace(weighed, verdict=verdict)

    @property
    def _problem(self) -> FitProblem:
        """The problem with the contrast and spread of the fit."""
        joint = self.joint
        return replace(self.problem, prior=joint.prior)

    @property
    def _log_odds(self) -> float:
        """Log-odds of a film before the pixels are looked at."""
        film = self.setting.asked == "on" or (self.setting.asked == "auto" and self.likely)
        return float(special.logit(1.0 - self._prior_doubt)) * (1.0 if film else -1.0)

    @property
    def _prior_doubt(self) -> float:
        """Probability of the less likely case, before the pixels are looked at."""
        by_hand = self.setting.asked != "auto"
        return max(self.setting.doubt, LEAST_DOUBT) if by_hand else 1.0 / (1.0 + ODDS)

    def _film_at(self, blur: float) -> Edge:
        return FilmEdge.of(blur, self.setting.rim)

    def _fit(self, edge_at: EdgeAt, blur: float | None = None) -> RimFit:
        """The isolated rims under an edge."""
        fit, problem = self.joint.fit, self._problem
        isolated = isolated_disks(fit.disks, problem.image.shape, blur=fit.blur)
        cut = touches(problem.saturated, 1, fit.disks, fit.disks[:, RADIUS])
        return fit_rims(
            problem, fit.disks[isolated[~cut[isolated]]], blur=blur or fit.blur, edge_at=edge_at,
            optics_prior=self.optics_prior, placement=self.placement,
        )  # fmt: skip

    def _verdict(self, ratios: RimRatios, radius: Values, shift: Values, *, cost: float = 0.0) -> FilmVerdict:
        """The verdict from log-likelihood ratios of the rims; the edge without a film pays ``cost``."""
        asked, n, total, std = self.setting.asked, len(ratios.values), ratios.total + cost, ratios.std
        data = 0.0
        if n >= FEWEST_RIMS:
            z = total / max(std, 1e-12)
            data = float(stats.t.logsf(-z, n - 1) - stats.t.logsf(z, n - 1))
            data = float(np.clip(data, -abs(total), abs(total)))
        odds = data + self._log_odds
        other_cause = asked == "auto" and self.likely is False
        taken = data > np.log(TAKEN_ODDS) if other_cause else odds > 0 if asked == "auto" else asked == "on"
        doubt = _probability(-odds if taken else odds)
        open_choice = asked != "auto" or (other_cause and not taken)
        if open_choice and _probability(-data if taken else data) > DECIDED_DOUBT:
            doubt = max(doubt, self._prior_doubt)  # rims that cannot tell do not speak for either case
        with_film = float(np.sum((radius + shift) ** 2) / np.sum(radius**2))
        change = 1.0 / with_film - 1.0 if taken else with_film - 1.0
        return FilmVerdict(asked, bool(taken), total, std, n, doubt, change)


def summarise_films(verdicts: Iterable[FilmVerdict]) -> str:
    """One line on the air films of a series.

    Examples
    --------
    >>> summarise_films([FilmVerdict("auto", False, -9.1, 1.5, 200, 1e-6, -0.02)])
    'air film: none on 1 of 1 frames; log-likelihood -9.1 +- 1.5 with it, over 200 rims'
    >>> summarise_films([FilmVerdict("off", False, -0.5, 1.5, 40, 0.4, -0.02)])
    'air film: none on 1 of 1 frames; log-likelihood -0.5 +- 1.5 with it, over 40 rims; the rims of 1 cannot
    tell, their uncertainties allow for both; with it the areas would change by -2 to -2 %'
    """
    numbers = (
        (one.taken, one.log_likelihood, one.std, one.rims, one.doubt, one.area_change) for one in verdicts
    )
    found = np.fromiter(numbers, (float, 6))
    taken, log_likelihood, std, rims, doubt, area_change = found.T
    frames = f"taken on {taken.sum():.0f}" if taken.any() else f"none on {len(found)}"
    changes = 100 * area_change[doubt > DECIDED_DOUBT]
    left = ""
    if len(changes):
        left = f"; the rims of {len(changes)} cannot tell, their uncertainties allow for both"
        other = f"{'without' if taken.any() else 'with'} it the areas would change by"
        left += f"; {other} {changes.min():+.2g} to {changes.max():+.2g} %"
    return (
        f"air film: {frames} of {len(found)} frames; log-likelihood {log_likelihood.sum():+.3g} +- "
        f"{np.sqrt(np.nansum(std**2)):.2g} with it, over {rims.sum():.0f} rims{left}"
    )


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


def _probability(log_odds: float) -> float:
    """The probability from the logarithm of odds."""
    return float(1.0 / (1.0 + np.exp(np.clip(-log_odds, -700.0, 700.0))))


def _changes_nothing(rim: FilmRim, radius: Values) -> bool:
    """Whether the light of the film is too little to change areas, from an upper bound at the quartiles."""
    for a in np.quantile(radius, [0.25, 0.75]):
        distance = np.linspace(0.0, max(rim.extent_px(float(a)), 1e-6), 200)
        light = float(np.trapezoid(np.abs(rim.excess(distance, float(a))), distance))
        if 2.0 * light / a > LEAST_AREA_CHANGE:
            return False
    return True


@dataclass(frozen=True, eq=False)
class FilmEdge(Edge):
    """Edge of contacts with a film; ``shape`` is that of the plain edge, 0.

    Parameters
    ----------
    rim : FilmRim
    """

    rim: FilmRim

    @classmethod
    def of(cls, blur: float, rim: FilmRim) -> "FilmEdge":
        """The edge at a blur (px, pixel included)."""
        return cls(blur, Edge.plain(blur).shape, rim)

    def profile(self, disks: PlacedDisks) -> Values:
        """Brightness of contacts over their contrast, shape (n, k)."""
        return self._look_up(disks, self.blur)[0]

    def by_radius(self, disks: PlacedDisks) -> Values:
        """Derivative of the profile by the radius, 1/px."""
        return self._look_up(disks, self.blur)[1] / self.blur

    def templates(self, disks: PlacedDisks, chosen: Sequence[int] = EVERY_TEMPLATE) -> Values:
        """Derivatives by the blur, and by the parameters of the edge as at the plain one."""
        up, down = (self._look_up(disks, self.blur * np.exp(x))[0] for x in (BLUR_STEP, -BLUR_STEP))
        templates = edge_templates(disks, self.blur, self.shape, chosen)
        templates[:, np.asarray(chosen) == 0] = ((up - down) / (2.0 * BLUR_STEP * self.blur))[:, None]
        return templates

    def without_film(self, image: NDArray[np.float32], disks: Values) -> NDArray[np.float32]:
        """The image of the same disks (x, y, radius, contrast) with the plain edge."""
        outer = film_table(self.rim, self.blur).outer
        inner = np.maximum(disks[:, RADIUS] - INNER_BLUR_WIDTHS * self.blur, 0.0)
        step = self.blur / FINE_STEPS_PER_BLUR
        count = round((INNER_BLUR_WIDTHS + outer) * FINE_STEPS_PER_BLUR) + 1
        field = np.zeros((len(disks), 5))
        placed = PlacedDisks(disks[:, [RADIUS]], field, radial_nodes(inner, step, count), 0.0)
        corrected = image.copy()
        plain = blurred_profile(placed, self.blur)
        add_profiles(corrected, disks, inner, plain - self.profile(placed), step)
        return corrected

    def _look_up(self, disks: PlacedDisks, blur: float) -> Values:
        """Profile and derivatives from the table of a blur."""
        return look_up(film_table(self.rim, blur).values, disks, np.full(disks.radius.shape, blur))


@dataclass(frozen=True, eq=False)
class FilmDirection(FilmEdge):
    """The plain edge, with the light of the film as the one direction into which it may change."""

    def profile(self, disks: PlacedDisks) -> Values:
        """Brightness of the plain edge over its contrast, shape (n, k)."""
        return blurred_profile(disks, self.blur)

    def by_radius(self, disks: PlacedDisks) -> Values:
        """Derivative of the plain edge by the radius, 1/px."""
        return BlurredDisks.of(disks, self.blur).by_a / self.blur

    def templates(self, disks: PlacedDisks, chosen: Sequence[int] = EVERY_TEMPLATE) -> Values:
        """Derivatives by the blur and by the share of the film, as far as chosen."""
        plain = BlurredDisks.of(disks, self.blur)
        film = self._look_up(disks, self.blur)[0] - plain.p
        both = (plain.by_s(disks) / self.blur**2, film)
        return np.stack([both[k] for k in chosen if k < len(both)], axis=1)
