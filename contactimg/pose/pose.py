"""Where the camera looks: the similarity between pixels and sample coordinates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

LARGEST_LENGTH = 0.01
"""Pixel size, or height of an asperity, in m above which a value is taken to be in another unit. Chosen by
hand."""


@dataclass(frozen=True)
class Pose:
    """Similarity between pixel coordinates and sample coordinates.

    A sample point ``s`` is seen at the pixel ``q = q0 + R(rotation) F (s - centre) / pixel_size`` with
    ``q = (x_px, y_px)``, ``q0`` the image centre ``((columns-1)/2, (rows-1)/2)``, ``R`` the rotation that
    turns +x towards +y (clockwise on the screen, where y points down), and ``F = diag(1, -1)`` if mirrored.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the image.
    pixel_size : float
        Sample length per pixel, m.
    centre : (float, float)
        Sample point at the image centre, m.
    rotation : float
        rad.
    mirrored : bool
        True if +y of the sample points up in the image.

    Raises
    ------
    InputError
        If the pixel size is not a positive number, or above `LARGEST_LENGTH`.
    """

    shape: tuple[int, int]
    pixel_size: float
    centre: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.pixel_size <= LARGEST_LENGTH:
            raise InputError(
                f"pixel size must be a positive length of at most {LARGEST_LENGTH} m, got "
                f"{self.pixel_size!r} m; give the sample length that one pixel covers"
            )

    @property
    def image_centre(self) -> NDArray[np.float64]:
        """(x_px, y_px) of the image centre."""
        rows, columns = self.shape
        return np.array([(columns - 1) / 2, (rows - 1) / 2])

    def to_pixels(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixel coordinates ``(x_px, y_px)`` of sample points (m)."""
        dx, dy = np.asarray(x, float) - self.centre[0], np.asarray(y, float) - self.centre[1]
        x_px, y_px = _turned(dx, self._flip * dy, self.rotation, 1 / self.pixel_size)
        return x_px + self.image_centre[0], y_px + self.image_centre[1]

    def to_sample(self, x_px: ArrayLike, y_px: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sample coordinates ``(x, y)`` in m of pixel positions."""
        middle = self.image_centre
        dx, dy = np.asarray(x_px, float) - middle[0], np.asarray(y_px, float) - middle[1]
        x, y = _turned(dx, dy, -self.rotation, self.pixel_size)
        return x + self.centre[0], self._flip * y + self.centre[1]

    @property
    def _flip(self) -> float:
        """Sense of +y of the sample in the image."""
        return -1.0 if self.mirrored else 1.0

    def angle_in_image(self, angle: ArrayLike) -> NDArray[np.float64]:
        """Direction of axes in the image, from +x_px towards +y_px, of directions on the sample (rad).

        From -pi/2 to pi/2: an axis has no sense.

        Examples
        --------
        >>> mirrored = Pose((11, 11), 1e-6, mirrored=True)
        >>> mirrored.angle_in_image([0.25]).round(6)
        array([-0.25])
        """
        turned = self._flip * np.asarray(angle, float) + self.rotation
        return np.asarray((turned + np.pi / 2) % np.pi - np.pi / 2)


def _turned(
    x: NDArray[np.float64], y: NDArray[np.float64], angle: float, size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points turned and scaled, each on its own: a product of matrices would round by how many there are."""
    c, s = size * np.cos(angle), size * np.sin(angle)
    return c * x - s * y, s * x + c * y
