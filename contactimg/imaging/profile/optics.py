"""Contrast, blur and halo common to all contacts of a frame, with their uncertainties."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.optics.psf import Halo


@dataclass(frozen=True, eq=False)
class EdgeKnowledge:
    """The likelihood of the edge that all contacts share, in the neighbourhood of the best edge.

    Parameters
    ----------
    families : tuple of str
        That their edge has, keys of `contactimg.imaging.profile.edge_shape.FAMILIES`.
    blur_px : float
        Of the edge, pixel included.
    shape : ndarray, shape (k,)
        Most probable parameters x of the edge, 0 for those of other families.
    information, vector : ndarray, shapes (k, k), (k,)
        Of all parameters, in units of the variances that contacts show: the logarithm of their likelihood is
        ``vector.x - x.information.x/2``.
    count : int
        Isolated contacts.
    """

    families: tuple[str, ...]
    blur_px: float
    shape: NDArray[np.float64]
    information: NDArray[np.float64]
    vector: NDArray[np.float64]
    count: int

    def score_at(self, shape: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivative of the logarithm of the likelihood."""
        return np.asarray(self.vector - self.information @ shape)


@dataclass(frozen=True)
class KnownEdge:
    """The edge of contacts as a reference contact shows it.

    Parameters
    ----------
    shift_px : float
        How far the edge seems to lie outside the true one.
    shift_std_px : float
        Its standard uncertainty.
    """

    shift_px: float
    shift_std_px: float


@dataclass(frozen=True)
class SharedOptics:
    """Contrast and blur of the contacts, with their uncertainties.

    Parameters
    ----------
    contrast : float
        Plateau minus background, grey levels, positive; NaN if not known.
    contrast_std : float
        Its standard uncertainty.
    spread : float
        Standard deviation of the contrast from contact to contact; NaN if not known.
    blur_px : float
        Standard deviation of the point spread function; NaN if not known.
    blur_std_px : float
        Its standard uncertainty.
    correlation : float
        Of the errors of contrast and blur.
    halo : Halo or None
        Wide part of the point spread function; None if there is none, or if it is not known.
    edge : EdgeKnowledge or None
        What is known of edges that are no disk behind one Gaussian; None if nothing is.
    known_edge : KnownEdge or None
        Where contacts end in their edges, for the method "disk"; None if no reference has told.
    relative : bool
        Contrasts are divided by the level of the background, so that drifts of the lamp cancel.

    Examples
    --------
    >>> SharedOptics(contrast=90.0, contrast_std=1.8, blur_px=1.4).scaled(0.5).contrast
    45.0
    """

    contrast: float = np.nan
    contrast_std: float = 0.0
    spread: float = np.nan
    blur_px: float = np.nan
    blur_std_px: float = 0.0
    correlation: float = 0.0
    halo: Halo | None = None
    edge: EdgeKnowledge | None = field(default=None, compare=False)
    known_edge: KnownEdge | None = None
    relative: bool = False

    def scaled(self, factor: float) -> "SharedOptics":
        """The optics with contrasts multiplied by ``factor``."""
        names = ("contrast", "contrast_std", "spread")
        return replace(self, **{name: factor * getattr(self, name) for name in names})

    def without_contrast(self) -> "SharedOptics":
        """The optics without what is known of the contrast."""
        return replace(self, contrast=np.nan, contrast_std=0.0, correlation=0.0)

    def with_edge(self, shift_px: float, shift_std_px: float | None) -> "SharedOptics":
        """The optics with what a reference contact has told of the edge; unchanged without an uncertainty."""
        return self if shift_std_px is None else replace(self, known_edge=KnownEdge(shift_px, shift_std_px))

    @property
    def is_uncertain(self) -> bool:
        """Whether contrast or blur are known, and none of them exactly."""
        known = np.isfinite([self.contrast, self.blur_px])
        return bool(known.any() and np.array([self.contrast_std, self.blur_std_px])[known].min() > 0.0)

    @property
    def contrast_relative_std(self) -> float:
        """Standard uncertainty of the contrast over the contrast."""
        return self.contrast_std / self.contrast


def combine_errors(std: NDArray[np.float64], modes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard uncertainty of each radius from its independent part and the parts common to all."""
    return np.sqrt(std**2 + np.sum(modes**2, axis=1))
