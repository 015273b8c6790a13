"""What a frame says of the edges of its contacts."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.edge_scores import Edge
from contactimg.imaging.profile.edge_shape import DOME, FIELD, RESPONSE, RIM, SOFTNESS, TREND
from contactimg.imaging.profile.optics import EdgeKnowledge

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LearnedEdge:
    """The edges that the frame shows.

    Parameters
    ----------
    edge : Edge
    families : tuple of str
        That take part, keys of `contactimg.imaging.profile.edge_shape.FAMILIES`; empty for a plain edge.
    std : ndarray
        Standard uncertainties of the parameters of the edge; 0 for those that take no part.
    undecided : ndarray, shape (n,), px
        Change of the radii by the other edge that would change the areas most.
    knowledge : EdgeKnowledge or None
        What the frame alone says of its edges, for others.
    """

    edge: Edge
    families: tuple[str, ...] = ()
    std: Values = field(default_factory=lambda: np.zeros(0))
    undecided: Values = field(default_factory=lambda: np.zeros(0))
    knowledge: EdgeKnowledge | None = None

    @property
    def gamma(self) -> tuple[float, float]:
        """Exponent of the camera's response and its uncertainty; (1, 0) for a linear one."""
        if "response" not in self.families:
            return 1.0, 0.0
        return 1.0 - float(self.edge.shape[RESPONSE]), float(self.std[RESPONSE])


def describe_edge(learned: LearnedEdge, *, binning: int) -> str:
    """What to say of an edge that is not plain; empty for a plain one."""
    edge, parts = learned.edge, []
    if "point spread" in learned.families:
        parts.append("a point spread function that is not a Gaussian")
    if "softness" in learned.families:
        width = np.sqrt(max(float(edge.shape[SOFTNESS]), 0.0))
        parts.append(
            f"a width that grows with the contact ({width:.2g} of the radius): a soft rim cannot be told "
            "from a larger contact"
        )
    if "rim" in learned.families:
        what = "light" if edge.shape[RIM] > 0 else "shadow"
        parts.append(
            f"{what} just outside the contacts ({abs(edge.shape[RIM]):.2g} of the contrast over a tenth of "
            "the radius), which cannot be told from a larger or smaller contact"
        )
    if "plateau" in learned.families:
        middle = "brighter" if edge.shape[DOME] > 0 else "darker"
        parts.append(f"contacts {middle} in the middle (by {abs(edge.shape[DOME]):.2g} of the contrast)")
    if "blur field" in learned.families:
        x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
        terms = np.stack([x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3], axis=-1)
        blur = edge.blur * binning * (1 + terms @ edge.shape[FIELD])
        parts.append(f"a blur between {blur.min():.2g} and {blur.max():.2g} px over the frame")
    if "contrast" in learned.families:
        trend = float(edge.shape[TREND])
        parts.append(
            f"small contacts {abs(trend):.2g} {'brighter' if trend > 0 else 'dimmer'} than large ones"
        )
    if "response" in learned.families:
        gamma, std = learned.gamma
        parts.append(
            f"the camera's response looks nonlinear: gamma about {gamma:.2f} +- {std:.2f} "
            "(set [camera] gamma, or switch it off in the camera)"
        )
    return "" if not parts else "the edges show " + ", and ".join(parts)
