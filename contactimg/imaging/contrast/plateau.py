"""Contrast of a frame and the level that a threshold stands for.

Level = background + threshold x (plateau - background), one plateau a frame; the difference image has its
background at 0.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.robust import median, quantile
from contactimg.imaging.shapes.objects import find_objects
from contactimg.timings import stage

BRIGHTER, FAINTER = 1.6, 0.6  # of the contacts: what is brighter or fainter is none

CORE = 6  # px: the plateau is read where a window of this width lies inside a contact
ENOUGH = 10  # values that give a plateau
SAMPLE = 20_000  # pixels that tell as much as all
VALUE, AROUND, WIDER = 0, 1, 2
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


@stage("contrast")
def measure_contrast(coarse: BinnedImage, noise: float) -> Contrast:
    """Plateau of the contacts in an image where they are positive and the background is zero.

    Parameters
    ----------
    coarse : BinnedImage
        The image.
    noise : float
        Of one pixel of the image at its own resolution.

    Returns
    -------
    Contrast
    """
    image, window = coarse.image, CORE // coarse.step
    floor = max(DETECTABLE * noise / coarse.step, 1e-6)
    high = _stand_out(image, window, floor)
    if high.shape[1] < 4:
        return Contrast(0.0, resolved=False)
    plateau, level = _settle(high, floor)
    if _mixed(high, floor, plateau, level):
        high = _stand_out(_usual_objects(image, max(FAINT * plateau, floor)), window, floor)
        plateau, level = _settle(high, floor)
    resolved = bool(np.count_nonzero(high[AROUND] > level) >= ENOUGH)
    return Contrast(plateau, resolved, _plateau_std(high, plateau, level) if resolved else GUESS * plateau)


def _stand_out(image: NDArray[np.float32], window: int, floor: float) -> NDArray[np.float32]:
    """Pixels above the floor: value, lowest in the window about it, and in one wider by a pixel on each side.

    Of many pixels, those of every so many rows, unless hardly any of these lies inside a contact.
    """
    around = cv2.erode(image, np.ones((window, window), np.uint8))
    wider = cv2.erode(around, np.ones((3, 3), np.uint8))
    above = image > np.float32(floor)
    every = max(int(np.count_nonzero(above)) // SAMPLE, 1)
    if every > 1 and np.count_nonzero(around[::every] > np.float32(floor)) < SAMPLE // 10:
        every = 1
    rows = slice(every // 2, None, every)
    return np.stack([part[rows][above[rows]] for part in (image, around, wider)])


def _settle(high: NDArray[np.float32], floor: float) -> tuple[float, np.float32]:
    """Median of the pixels whose surroundings reach half of it, and the level that these reached."""
    plateau = quantile(high[VALUE], 0.95) if high.size else 0.0
    for _ in range(4):
        level = np.float32(max(0.5 * plateau, floor))
        values = high[VALUE][high[AROUND] > level]
        if len(values) < ENOUGH:
            break
        before, plateau = plateau, median(values)
        if abs(plateau - before) < 0.03 * plateau:
            break
    return plateau, level


def _mixed(high: NDArray[np.float32], floor: float, plateau: float, level: np.float32) -> bool:
    """Whether wide things of quite another brightness than the plateau stand in the image."""
    pixels, around, _ = high
    if np.count_nonzero((around > level) & (pixels > np.float32(BRIGHTER * plateau))) >= ENOUGH:
        return True
    low = (pixels > np.float32(max(FAINT * plateau, floor))) & (pixels < np.float32(FAINTER * plateau))
    # not the slope of something bright, nor something too small to show how bright it is: level all around
    return bool(np.count_nonzero(low & (around > np.float32(LEVEL) * pixels)) >= ENOUGH)


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


def _plateau_std(high: NDArray[np.float32], plateau: float, level: np.float32) -> float:
    """Uncertainty of a plateau from its scatter, and from how much higher it is further inside."""
    values, core = (high[VALUE][high[window] > level] for window in (AROUND, WIDER))
    rise = (median(core) if len(core) else float(values.max())) - plateau
    return float(np.hypot(MEDIAN * values.std() / np.sqrt(max(len(values) / SHARED, 1.0)), rise))
