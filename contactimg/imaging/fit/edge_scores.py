"""Whether the residuals of all contacts together call for another edge, and for which.

Each isolated contact has a score on the shared quantities ``q = (ln C, s, parameters of the edge)``: the sum
over its pixels of residual times derivative over variance, with its own radius, contrast and background
eliminated. With J the information of q left then, the shared quantities that suit all contacts best differ by

    delta = (sum J)^-1 sum score,        covariance H^-1 (sum e e') H^-1,   e = score - J delta,

from those assumed (a Gauss-Newton step; the covariance is that of the scatter from contact to contact, which
holds whatever the noise, drawn to H^-1 where contacts are few). A group of parameters is significant by
Wald's test of this step.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem, X, Y, touches
from contactimg.imaging.fit.shared_optics import OpticsPrior
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.kernels.radial_sums import add_profiles, radial_nodes, sum_residuals
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, PIXEL_VARIANCE
from contactimg.imaging.profile.edge_shape import (
    FAMILIES,
    LARGEST,
    PARAMETERS,
    PRIOR_STD,
    BlurredDisks,
    PlacedDisks,
    blurred_profile,
    edge_profile,
    edge_templates,
    look_up,
)
from contactimg.imaging.profile.film_rim import FilmRim, film_table
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, FAINT_FRACTION, FEW, LONGEST_BLUR_STEP

Values = NDArray[np.float64]

STEPS_PER_BLUR = 4  # nodes of templates about the rim; accuracy: affects the efficiency alone
FINE_STEPS_PER_BLUR = 16  # nodes of profiles; theory: linear interpolation errs by (1/16)^2/8 * 0.24 = 1e-4
PLATEAU_BLUR_WIDTHS = 4.5  # distance inside the rim where the plateau begins; theory: 3e-6 are missing there
SMALLEST_BLUR_WIDTHS = 0.5  # radius of contacts that are looked at; smaller ones show no edge
MOST_CONTACTS = 250  # that are looked at, evenly chosen among the radii; for time
FEW_CONTACTS = 60  # the same of the first look; for time
FEWEST_SCORES = 5
"""Isolated contacts below which their scores say nothing. Chosen: with fewer, one odd contact decides."""
FALSE_ALARM = 1e-5
"""Probability that a plain edge is taken for another one. False-alarm rate: one in a hundred thousand
frames for each family; what is less certain enters the uncertainties
(`contactimg.imaging.fit.edge_profile`)."""
SUSPICION = 0.01
"""The same for a closer look, for each family. False-alarm rate: it costs time alone."""
LEAST_CLIP_FRACTION = 0.5
"""Residuals are clipped at this fraction of the contrast, or at 5 sigma of a pixel. By hand: it cuts foreign
objects, not an edge of another shape."""
OWN = 3  # contrast and radius of a contact, and the background about it
SHARED = 2  # ln C and the blur come before the parameters of the edge
FILM = SHARED + len(PARAMETERS)  # the light of a film comes after them
EVERY = np.arange(FILM)
"""What contacts without a film may share."""
LONGEST_SHAPE_STEP = 0.5  # of the largest magnitude of a parameter; accuracy
LARGEST_LIGHT = 10.0  # of a film, over that expected; accuracy: keeps steps finite


@dataclass(frozen=True, eq=False)
class Edge:
    """Blur and shape of the edge that all contacts share.

    Parameters
    ----------
    blur : float, px
        Pixel included.
    shape : ndarray
        Values of `contactimg.imaging.profile.edge_shape.PARAMETERS`.
    film : FilmRim or None
        Air film that may shine beside the contacts.
    light : float
        Light of the film over that expected.
    """

    blur: float
    shape: Values
    film: FilmRim | None = None
    light: float = 0.0

    @classmethod
    def plain(cls, blur: float) -> "Edge":
        """A disk behind one Gaussian."""
        return cls(blur, np.zeros(len(PARAMETERS)))

    @property
    def shared(self) -> Values:
        """The shared quantities but ln C, which is 0 here: blur, shape and light."""
        return np.array([0.0, self.blur, *self.shape, self.light])

    def moved(self, chosen: NDArray[np.int64], delta: Values) -> "Edge":
        """The edge after a step of some shared quantities, within limits."""
        change, shape = np.zeros(FILM + 1), self.shape
        change[chosen] = delta
        longest = LONGEST_BLUR_STEP * self.blur
        blur = max(self.blur + float(np.clip(change[1], -longest, longest)), PIXEL_VARIANCE**0.5)
        steps = np.clip(change[SHARED:FILM], -LONGEST_SHAPE_STEP * LARGEST, LONGEST_SHAPE_STEP * LARGEST)
        light = self.light + float(np.clip(change[FILM], -1.0, 1.0))
        light = float(np.clip(light, -LARGEST_LIGHT, LARGEST_LIGHT))
        return replace(self, blur=blur, shape=np.clip(shape + steps, -LARGEST, LARGEST), light=light)

    @property
    def reach(self) -> float:
        """Distance beyond the rim up to which the edge changes anything, blur widths."""
        return film_table(self.film, self.blur).outer if self.film and self.light else INNER_BLUR_WIDTHS

    def profile(self, disks: PlacedDisks) -> Values:
        """Brightness of contacts over their contrast, shape (n, k)."""
        profile = edge_profile(disks, self.blur, self.shape)
        return profile + self.light * self._film(disks, self.blur) if self.light else profile

    def by_radius(self, disks: PlacedDisks) -> Values:
        """Derivative of the profile by the radius, 1/px."""
        if not self.shape.any() and not self.light:
            return BlurredDisks.of(disks, self.blur).by_a / self.blur
        step = 0.05 * self.blur
        above, below = (self.profile(disks.widened(x)) for x in (step, -step))
        return (above - below) / (2 * step)

    def templates(self, disks: PlacedDisks, chosen: NDArray[np.int64]) -> Values:
        """Derivatives of the profile by some of the shared quantities but ln C, shape (n, m, k)."""
        templates = edge_templates(disks, self.blur, self.shape, [int(k) - 1 for k in chosen if k != FILM])
        if self.light and 1 in chosen:
            step = 0.02 * self.blur
            above, below = (self._film(disks, self.blur + x) for x in (step, -step))
            templates[:, 0] += self.light * (above - below) / (2 * step)
        if FILM in chosen:
            templates = np.concatenate([templates, self._film(disks, self.blur)[:, None]], axis=1)
        return templates

    def _film(self, disks: PlacedDisks, blur: float) -> Values:
        """Light of the film, over the contrast of the contacts."""
        if self.film is None:
            return np.zeros_like(disks.distance)
        blurs = np.full(disks.radius.shape, blur)
        return look_up(film_table(self.film, blur).values, disks, blurs, 1)[0] - blurred_profile(disks, blur)


@dataclass(frozen=True, eq=False)
class Placement:
    """The places of contacts, and their strength against the background.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the image.
    ratio : float
        Contrast over background level; negative for dark contacts.
    """

    shape: tuple[int, int]
    ratio: float

    def place(
        self, disks: Values, *, blur: float, per_blur: int = STEPS_PER_BLUR, reach: float = INNER_BLUR_WIDTHS
    ) -> "PlacedNodes":
        """Disks with nodes from their centres to beyond their rims."""
        x, y = (2.0 * disks[:, k] / max(self.shape[1 - k] - 1.0, 1.0) - 1.0 for k in (X, Y))
        field = np.stack([x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3], axis=-1)
        inner = np.maximum(disks[:, RADIUS] - PLATEAU_BLUR_WIDTHS * blur, 0.0)
        step = blur / per_blur
        count = round((PLATEAU_BLUR_WIDTHS + reach) * per_blur) + 1
        placed = PlacedDisks(disks[:, [RADIUS]], field, radial_nodes(inner, step, count), self.ratio)
        return PlacedNodes(placed, inner, step, count)


@dataclass(frozen=True, eq=False)
class PlacedNodes:
    """Disks with their nodes, see `contactimg.imaging.kernels.radial_sums`.

    Parameters
    ----------
    disks : PlacedDisks
    inner : ndarray, shape (n,), px
        Distance from the centre up to which nodes are wide.
    step : float, px
        Between the nodes beyond.
    count : int
        Nodes beyond.
    """

    disks: PlacedDisks
    inner: Values
    step: float
    count: int

    @property
    def areas(self) -> Values:
        """Area of the ring that belongs to each node, px^2, shape (n, k)."""
        r = self.disks.distance
        return np.asarray(2.0 * np.pi * r * np.gradient(r, axis=1))


def isolated_disks(problem: FitProblem, disks: Values, *, blur: float) -> NDArray[np.int64]:
    """Contacts whose profile no neighbour and no border disturbs, from the narrowest to the widest."""
    reach, (rows, columns) = INNER_BLUR_WIDTHS * blur, problem.image.shape
    alone = np.ones(len(disks), np.bool_)
    alone[find_pairs(disks, 0.5 * (reach + EDGE_BLUR_WIDTHS * blur)).ravel()] = False
    x, y, margin = disks[:, X], disks[:, Y], disks[:, RADIUS] + reach
    alone &= (x > margin) & (y > margin) & (x < columns - 1 - margin) & (y < rows - 1 - margin)
    chosen = np.flatnonzero(alone & (disks[:, RADIUS] > SMALLEST_BLUR_WIDTHS * blur))
    chosen = evenly(chosen[np.argsort(disks[chosen, RADIUS], kind="stable")], MOST_CONTACTS)
    # a plateau that is cut off by the sensor looks like another edge
    return chosen[~touches(problem.saturated, 1, disks, disks[:, RADIUS])[chosen]]


def evenly(chosen: NDArray, most: int) -> NDArray:
    """A number of contacts, at most ``most``, evenly spaced."""
    if len(chosen) <= most:
        return chosen
    return chosen[np.linspace(0, len(chosen) - 1, most).round().astype(int)]


@dataclass(frozen=True, eq=False)
class SharedStep:
    """Step of the shared quantities that suits all contacts best.

    Parameters
    ----------
    chosen : ndarray of int
        Which of (ln C, s, `PARAMETERS`, light of the film) take part.
    delta : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    gain : float
        Decrease of chi-square, in units of its usual value.
    """

    chosen: NDArray[np.int64]
    delta: Values
    covariance: Values
    gain: float

    def excess(self, columns: tuple[int, ...], false_alarm: float = FALSE_ALARM) -> float:
        """Wald's statistic of some parameters of the edge over its quantile at a false-alarm rate."""
        at = np.flatnonzero(np.isin(self.chosen - SHARED, columns))
        part = self.delta[at]
        statistic = part @ np.linalg.solve(self.covariance[np.ix_(at, at)], part)
        return float(statistic / special.chdtri(len(at), false_alarm))


@dataclass(frozen=True, eq=False)
class EdgeScores:
    """Scores of contacts on the shared quantities, and how their radii follow them.

    Parameters
    ----------
    score : ndarray, shape (m, 18)
        0, like what follows, for the shared quantities that were not asked for.
    information : ndarray, shape (m, 18, 18)
    response : ndarray, shape (m, 18)
        Derivative of the radius by the shared quantities, px.
    radius_std : ndarray, shape (m,), px
        For independent pixels at a known edge.
    radius : ndarray, shape (m,), px
    own_step : ndarray, shape (m, 3)
        Newton step of contrast, radius and background of each at the shared quantities assumed.
    own_response : ndarray, shape (m, 3, 18)
        Their derivatives by the shared quantities.
    kept : ndarray of bool, shape (n,)
        Which of the contacts asked for these are: those with few masked pixels.
    least_factor : float
        Factor of the variances at least, for noise that neighbouring pixels share.
    """

    score: Values
    information: Values
    response: Values
    radius_std: Values
    radius: Values
    own_step: Values
    own_response: Values
    kept: NDArray[np.bool_]
    least_factor: float = 1.0

    @classmethod
    def of(
        cls, problem: FitProblem, disks: Values, edge: Edge, placement: Placement,
        chosen: NDArray[np.int64] = EVERY,
    ) -> "EdgeScores":  # fmt: skip
        """Scores of isolated disks (x, y, radius, contrast) from pixels."""
        nodes = placement.place(disks, blur=edge.blur)
        fine = placement.place(disks, blur=edge.blur, per_blur=FINE_STEPS_PER_BLUR)
        profile = edge.profile(fine.disks)
        clip = max(SIGNIFICANT_SIGMA * problem.pixel_noise, LEAST_CLIP_FRACTION * problem.contrast)
        rest = sum_residuals(
            problem.image, for_kernel(problem.valid), disks, nodes.inner, profile,
            (fine.step, nodes.step), nodes.count, clip,
        )  # fmt: skip
        whole = np.isfinite(rest[:, 0])
        return replace(cls.expected(problem, disks[whole], edge, placement, chosen, rest[whole]), kept=whole)

    @classmethod
    def expected(
        cls, problem: FitProblem, disks: Values, edge: Edge, placement: Placement,
        chosen: NDArray[np.int64] = EVERY, rest: Values | float = 0.0,
    ) -> "EdgeScores":  # fmt: skip
        """Information and responses, radius and contrast of each disk eliminated.

        ``chosen``: which shared quantities, ln C the first; ``rest``: residuals at the nodes, none expected.
        """
        nodes = placement.place(disks, blur=edge.blur)
        profile, templates = edge.profile(nodes.disks), edge.templates(nodes.disks, chosen[1:])
        contrast, tight = problem.prior.mean, 1.0 / problem.prior.std**2
        c = disks[:, CONTRAST, None]
        variance = problem.noise.variance / problem.brightness_at(disks)[:, None]
        weight = 1.0 / (variance * problem.noise.at(np.clip(profile, 0.0, 1.0)))
        # nodes reach equally far from every centre: those of small contacts would lie among other rims
        weight[nodes.disks.distance > nodes.disks.radius + INNER_BLUR_WIDTHS * edge.blur] = 0.0
        # columns: own contrast, radius and background, then the blur and the parameters of the edge
        columns = np.empty((len(disks), OWN + templates.shape[1], profile.shape[1]))
        columns[:, 0], columns[:, 1], columns[:, 2] = profile, c * edge.by_radius(nodes.disks), 1.0
        columns[:, OWN:] = c[:, None] * templates
        products = columns @ np.swapaxes(columns * (weight * nodes.areas)[:, None], 1, 2)
        normal, by_edge = products[:, :OWN, :OWN], chosen[1:]
        normal[:, 0, 0] += tight
        normal[:, 2, 2] += 1.0 / (FAINT_FRACTION * contrast) ** 2
        cross, score = np.zeros((len(disks), OWN, FILM + 1)), np.zeros((len(disks), FILM + 1))
        information = np.zeros((len(disks), FILM + 1, FILM + 1))
        cross[:, 0, 0], cross[:, :, by_edge] = -tight * contrast, products[:, :OWN, OWN:]
        information[:, 0, 0] = tight * contrast**2
        information[:, by_edge[:, None], by_edge] = products[:, OWN:, OWN:]
        gradient = (columns @ (weight * rest)[:, :, None])[:, :, 0]
        excess = disks[:, CONTRAST] - contrast
        gradient[:, 0] -= tight * excess
        score[:, 0], score[:, by_edge] = tight * contrast * excess, gradient[:, OWN:]
        inverse = np.linalg.inv(normal)
        response = -inverse @ cross
        return cls(
            score + (gradient[:, None, :OWN] @ response)[:, 0],
            information + np.swapaxes(cross, 1, 2) @ response,
            response[:, 1], np.sqrt(inverse[:, 1, 1]), disks[:, RADIUS],
            (inverse @ gradient[:, :OWN, None])[:, :, 0], response, np.ones(len(disks), np.bool_),
        )  # fmt: skip

    def step(self, chosen: NDArray[np.int64], prior: tuple[Values, Values]) -> SharedStep:
        """The step of some shared quantities; ``prior`` is (score, information) of a prior of all of them."""
        here = np.ix_(chosen, chosen)
        total, factor, rest = self._scatter(chosen)
        n, k = rest.shape
        posterior = np.linalg.inv(total / factor + prior[1][here])
        whole = self.score[:, chosen].sum(axis=0) / factor + prior[0][chosen]
        expected = (FEW + k) / n * factor * total
        scatter = (rest.T @ rest + expected) * n / (n + FEW) / factor**2 + prior[1][here]
        covariance = posterior @ scatter @ posterior
        return SharedStep(chosen, posterior @ whole, covariance, float(whole @ posterior @ whole))

    def _scatter(self, chosen: NDArray[np.int64]) -> tuple[Values, float, Values]:
        """Information of some shared quantities, the factor of the variances, and what each score leaves."""
        score, information = self.score[:, chosen], self.information[:, chosen][:, :, chosen]
        total = information.sum(axis=0)
        loose = np.linalg.inv(total + 1e-9 * np.diag(np.diag(total) + 1e-12))
        rest = score - information @ (loose @ score.sum(axis=0))
        return total, max(float(np.vdot(rest @ loose, rest)) / len(chosen), self.least_factor), rest

    def total(self, chosen: NDArray[np.int64]) -> tuple[Values, Values]:
        """Score and information of all contacts, over the factor of the variances that they show."""
        _, factor, _ = self._scatter(chosen)
        return self.score.sum(axis=0) / factor, self.information.sum(axis=0) / factor


def with_plain_edges(
    image: NDArray[np.float32], disks: Values, edge: Edge, placement: Placement
) -> NDArray[np.float32]:
    """The image of the same disks (x, y, radius, contrast) with a plain edge of the same blur."""
    nodes = placement.place(disks, blur=edge.blur, per_blur=FINE_STEPS_PER_BLUR, reach=edge.reach)
    image, plain = image.copy(), blurred_profile(nodes.disks, edge.blur)
    add_profiles(image, disks, nodes.inner, plain - edge.profile(nodes.disks), nodes.step)
    return image


def edge_prior(edge: Edge, optics: OpticsPrior, contrast: float) -> tuple[Values, Values]:
    """Score and information of the priors, none of the light; ``optics``: that of (ln C, s)."""
    score = np.array([*optics.score(contrast, edge.blur), *(-edge.shape / PRIOR_STD**2), 0.0])
    information = np.diag(np.array([0.0, 0.0, *(1.0 / PRIOR_STD**2), 0.0]))
    information[:SHARED, :SHARED] = optics.information
    return score, information


def parameters_of(families: tuple[str, ...]) -> NDArray[np.int64]:
    """Places of ln C, s and the parameters of families; a point spread function has widths of its own."""
    columns = [SHARED + k for name in families for k in FAMILIES[name]]
    return np.array([0, *columns] if "point spread" in families else [0, 1, *columns])
