"""Where a frame lies against its reference: a similarity transform with its uncertainty."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Alignment:
    """Position in the frame = centre + scale x rotation (position in the reference - centre) + shift.

    Parameters
    ----------
    x_px, y_px : float
        Shift at the centre of the image; zero if the images do not determine it.
    std_px : float
        Standard uncertainty of each; infinite if the images do not determine them.
    rotation : float, rad
        From x towards y (clockwise on the screen).
    scale : float
    consistent : bool
        Whether frame and reference agree all over the image, not only near the centre of a rotation.
    """

    x_px: float
    y_px: float
    std_px: float
    rotation: float = 0.0
    scale: float = 1.0
    consistent: bool = True

    @property
    def known(self) -> bool:
        """Whether the images determine the shift."""
        return bool(np.isfinite(self.std_px))

    @property
    def is_shift(self) -> bool:
        """Whether there is neither rotation nor change of scale."""
        return self.rotation == 0.0 and self.scale == 1.0

    @property
    def largest_px(self) -> float:
        """Larger component of the shift, px."""
        return max(abs(self.x_px), abs(self.y_px))

    def after(self, first: "Alignment") -> "Alignment":
        """The transform ``first`` followed by this one; the uncertainty is this one's.

        Examples
        --------
        >>> both = Alignment(1.0, 0.0, 0.1).after(Alignment(0.0, 2.0, 0.1, rotation=0.01))
        >>> both.x_px, both.y_px, both.rotation
        (1.0, 2.0, 0.01)
        """
        moved = self.scale * np.exp(1j * self.rotation) * complex(first.x_px, first.y_px)
        return replace(
            self,
            x_px=float(moved.real) + self.x_px,
            y_px=float(moved.imag) + self.y_px,
            rotation=self.rotation + first.rotation,
            scale=self.scale * first.scale,
        )

    def to_reference(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Matrix and offset that turn (x, y) in the frame into (x, y) in the reference."""
        centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
        c, s = np.cos(self.rotation) / self.scale, np.sin(self.rotation) / self.scale
        matrix = np.array([[c, s], [-s, c]])
        return matrix, centre - matrix @ (centre + np.array([self.x_px, self.y_px]))


UNKNOWN = Alignment(0.0, 0.0, np.inf)
"""Neither image determines anything."""
