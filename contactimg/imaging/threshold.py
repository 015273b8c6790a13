"""Contrast of a frame and the level that a threshold stands for.

Level = background + threshold x (plateau - background), one plateau a frame; the difference image has its
background at 0.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.imaging.foreign import BRIGHTER, FAINTER, find_objects
from contactimg.timings import stage

__all__ = ["Contrast", "choose_threshold", "find_polarity", "measure_contrast"]

CORE = 6  # px: the plateau is read where a window of this width lies inside a contact
ENOUGH = 10  # values that give a plateau
DETECTABLE = 6.0  # noise standard deviations
MEDIAN = 1.2533  # sqrt(pi/2): error of a median over that of a mean
SHARED = 4.0  # neighbouring values that texture gives the same error
FAINT = 0.15  # of the plateau: the faintest contacts that something bright does not hide
LEVEL = 0.7  # of a pixel that all its surroundings have where something is level
WIDE = 12  # pixels of a region that shows how bright it is
GUESS = 0.66  # relative uncertainty of the brightest spots as plateau: anything up to ten times as bright


@dataclass(frozen=True)
class Contrast:
    """Plateau of the contacts above the background.

    Parameters
    ----------
    plateau : float
        Grey levels; 0 when nothing stands out of the noise.
    resolved : bool
        True if contacts wide enough to show their plateau gave it, False if it was guessed from the brightest
        spots.
    std : float
        Standard uncertainty of the plateau, grey levels.
    """

    plateau: float
    resolved: bool
    std: float = float("nan")


def find_polarity(blocks: NDArray, noise: float) -> str:
    """``"bright"`` or ``"dark"``: the side of zero on which block means of the difference have more tail."""
    excess = np.abs(blocks) - 4.0 * noise
    tail = np.where(excess > 0, blocks, 0.0)
    return "dark" if np.nansum(tail) < 0 else "bright"


@stage("contrast")
def measure_contrast(image: NDArray[np.float32], noise: float) -> Contrast:
    """Plateau of the contacts in an image where they are positive and the background is zero.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    noise : float
        Of one pixel.

    Returns
    -------
    Contrast
    """
    # 2 x 2 means have half the noise and a quarter of the pixels
    rows, columns = image.shape
    small = (
        image
        if min(rows, columns) < 16
        else cv2.resize(image, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    )
    window = np.ones((CORE // 2, CORE // 2) if small is not image else (CORE, CORE), np.uint8)
    floor = max(DETECTABLE * noise / (2.0 if small is not image else 1.0), 1e-6)
    high = small[small > floor]
    if len(high) < 4:
        return Contrast(0.0, resolved=False)
    guess = float(np.percentile(high[:: max(len(high) // 5000, 1)], 95))
    plateau, inside = _settle(small, window, floor, guess)
    if _mixed(small, window, floor, plateau, inside):
        small = _usual_objects(small, max(FAINT * plateau, floor))
        high = small[small > floor]
        guess = float(np.percentile(high[:: max(len(high) // 5000, 1)], 95)) if len(high) else 0.0
        plateau, inside = _settle(small, window, floor, guess)
    resolved = bool(np.count_nonzero(inside) >= ENOUGH)
    return Contrast(plateau, resolved, _plateau_std(small, inside, plateau) if resolved else GUESS * plateau)


def _settle(
    image: NDArray[np.float32], window: NDArray[np.uint8], floor: float, plateau: float
) -> tuple[float, NDArray[np.uint8]]:
    """Median of the pixels whose surroundings reach half of it, and where those are."""
    inside = np.zeros(image.shape, np.uint8)
    for _ in range(4):
        inside = cv2.erode((image > max(0.5 * plateau, floor)).view(np.uint8), window)
        values = image[inside > 0]
        if len(values) < ENOUGH:
            break
        before, plateau = plateau, float(np.median(values[:: max(len(values) // 5000, 1)]))
        if abs(plateau - before) < 0.03 * plateau:
            break
    return plateau, inside


def _mixed(
    image: NDArray[np.float32],
    window: NDArray[np.uint8],
    floor: float,
    plateau: float,
    inside: NDArray[np.uint8],
) -> bool:
    """Whether wide things of quite another brightness than the plateau stand in the image."""
    if np.count_nonzero(image[inside > 0] > BRIGHTER * plateau) >= ENOUGH:
        return True
    low = np.flatnonzero((image > max(FAINT * plateau, floor)) & (image < FAINTER * plateau))
    if len(low) < ENOUGH:
        return False
    # not the slope of something bright, nor something too small to show how bright it is: level all around
    around = cv2.erode(image, window).ravel()[low]
    return bool(np.count_nonzero(around > LEVEL * image.ravel()[low]) >= ENOUGH)


def _usual_objects(image: NDArray[np.float32], level: float) -> NDArray[np.float32]:
    """The image without objects that are long, or of another brightness than most that are not."""
    found = find_objects(image, level)
    wide = ~found.long & (found.area >= WIDE)
    if not wide.any():
        wide = ~found.long
    if not wide.any():
        return image
    usual = float(np.median(found.peak[wide]))
    kept = wide & (found.peak > FAINTER * usual) & (found.peak < BRIGHTER * usual)
    return np.where(np.append(kept, np.False_)[found.labels], image, np.float32(0.0))


def _plateau_std(image: NDArray[np.float32], inside: NDArray[np.uint8], plateau: float) -> float:
    """Uncertainty of a plateau from its scatter, and from how much higher it is further inside."""
    values = image[inside > 0]
    core = image[cv2.erode(inside, np.ones((3, 3), np.uint8)) > 0]
    rise = float(np.median(core)) - plateau if len(core) else float(values.max()) - plateau
    return float(np.hypot(MEDIAN * values.std() / np.sqrt(max(len(values) / SHARED, 1.0)), rise))


def choose_threshold(image: NDArray[np.float32], contrast: Contrast, threshold: float | str | None) -> float:
    """The fraction to use: a number as given, 0.5 for None, Otsu's two-class optimum for ``"auto"``.

    Raises
    ------
    InputError
        If it is not a fraction between 0 and 1.
    """
    if threshold is None:
        return 0.5
    if isinstance(threshold, str):
        if threshold != "auto":
            raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
        return _otsu(image, contrast.plateau)
    if not 0 < threshold < 1:
        raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
    return float(threshold)


def _otsu(image: NDArray[np.float32], plateau: float) -> float:
    """Fraction of the plateau that separates background and contacts with least variance inside both."""
    if plateau <= 0:
        return 0.5
    scaled = np.clip(image * (200.0 / plateau), 0, 255).astype(np.uint8)
    level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return float(np.clip((level + 0.5) / 200.0, 0.05, 0.95))
