"""The edge of contacts with an air film, in place of the plain one, for scores and likelihoods."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.edge_scores import EVERY_TEMPLATE, FINE_STEPS_PER_BLUR, INNER_BLUR_WIDTHS, Edge
from contactimg.imaging.fit.problem import RADIUS
from contactimg.imaging.kernels.radial_sums import add_profiles, radial_nodes
from contactimg.imaging.profile.edge_shape import (
    BlurredDisks,
    PlacedDisks,
    blurred_profile,
    edge_templates,
    look_up,
)
from contactimg.imaging.profile.film_rim import Rim
from contactimg.imaging.profile.film_tables import film_table

Values = NDArray[np.float64]

BLUR_STEP = 0.02  # of the logarithm of the blur in its derivative; accuracy


@dataclass(frozen=True, eq=False)
class FilmEdge(Edge):
    """Edge of contacts with a film; ``shape`` is that of the plain edge, 0.

    Parameters
    ----------
    rim : Rim
    """

    rim: Rim

    @classmethod
    def of(cls, blur: float, rim: Rim) -> "FilmEdge":
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
        """The same as that of the plain edge."""
        return blurred_profile(disks, self.blur)

    def by_radius(self, disks: PlacedDisks) -> Values:
        """The same as that of the plain edge."""
        return BlurredDisks.of(disks, self.blur).by_a / self.blur

    def templates(self, disks: PlacedDisks, chosen: Sequence[int] = EVERY_TEMPLATE) -> Values:
        """Derivatives by the blur and by the share of the film, as far as chosen."""
        plain = BlurredDisks.of(disks, self.blur)
        film = self._look_up(disks, self.blur)[0] - plain.p
        both = (plain.by_s(disks) / self.blur**2, film)
        return np.stack([both[k] for k in chosen if k < len(both)], axis=1)
