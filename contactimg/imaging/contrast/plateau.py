"""Contrast of the contacts: their plateau above the background, which is 0 in a difference image.

A threshold is a fraction of it: level = background + threshold x (plateau - background), one plateau a frame.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.robust import median, quantile, robust_std
from contactimg.imaging.shapes.labelled_regions import label_regions
from contactimg.timings import stage

BRIGHTER_RATIO, FAINTER_RATIO = 1.6, 0.6
"""Peak over the usual plateau above and below which an object is not a contact. Chosen by hand on rendered
frames; sensitivity not measured."""
CORE_PX = 6
"""Width of a window that must lie inside a contact for its middle to show the plateau: the middle is then two
blur widths from the rim for a blur of 1.4 px."""
LEAST_WINDOW = 2  # binned pixels; fewer bound nothing
LEAST_PLATEAU_PIXELS = 10
"""Pixels that give a plateau. Chosen by hand."""
SAMPLE_PIXELS = 20_000
"""Pixels of an image that are looked at, if there are more: they give a median to 1 % of the scatter."""
DETECTION_SIGMA = 6.0
"""Height of a pixel above the background that is not noise, standard deviations. False-alarm rate 1e-9 a
pixel (theory: normal noise)."""
MEDIAN_STD_RATIO = 1.2533
"""Standard error of a median over that of a mean. Theory: sqrt(pi/2), normal values."""
TEXTURE_CORRELATED_PIXELS = 4.0
"""Neighbouring pixels whose errors the surface texture makes equal. Chosen by hand."""
FAINTEST_RATIO = 0.15
"""Of the brightest plateau: level down to which fainter objects are looked for. Chosen by hand."""
LEVEL_RATIO = 0.7
"""Lowest pixel of the window over its middle above which an object is level there. Chosen by hand."""
WIDE_AREA = 12
"""Binned pixels of a region that is wide enough to show its brightness. Chosen by hand."""
UNRESOLVED_RELATIVE_STD = 0.66
"""Relative standard uncertainty of a plateau guessed from the brightest spots. Theory: ln(10)/sqrt(12), if
the plateau may be anything up to ten times as bright."""
SETTLED_CHANGE = 0.03
"""Relative change of the plateau below which the iteration ends."""

COARSEST_STEP = 8
"""Binning at which contacts are looked for whose contrast the noise of a pixel hides. Chosen: they are then
wider than 16 px."""
HIDDEN_RATIO = 1.5
"""What stands out, over the level from which it does, below which it may be peaks of noise on contacts.
Theory: noise adds three standard deviations to the brightest of a thousand pixels, half of the level."""

VALUE, AROUND, WIDER = 0, 1, 2
"""Rows of the array of pixels that stand out: value, and lowest value in two windows around."""


@dataclass(frozen=True)
class Contrast:
    """Plateau of the contacts above the background.

    Parameters
    ----------
    plateau : float
        Grey levels; 0 when nothing stands out of the noise.
    resolved : bool
        True if measured inside contacts wide enough to show it, False if guessed from the brightest spots.
    std : float
        Standard uncertainty of the plateau, grey levels.
    hidden : bool
        Whether noise hides it in the pixels: it was measured in means over blocks of them.
    """

    plateau: float
    resolved: bool
    std: float = float("nan")
    hidden: bool = False

    def within(self, largest: float) -> "Contrast":
        """With a plateau that does not exceed the largest possible one."""
        return replace(self, plateau=min(self.plateau, largest))


@stage("contrast")
def measure_contrast(binned: BinnedImage, noise: float) -> Contrast:
    """Measure the plateau of the contacts of a difference image in which they are positive.

    Parameters
    ----------
    binned : BinnedImage
    noise : float
        Standard deviation of one pixel before binning.

    Returns
    -------
    Contrast
        Of the image binned more coarsely where the noise of its pixels hides contacts that are wide.
    """
    floor = max(DETECTION_SIGMA * noise / binned.step, 1e-6)
    found, coarse = _measure(binned, floor), binned.coarser()
    if found.resolved or found.plateau > HIDDEN_RATIO * floor or not noise > 0.0:
        return found
    while coarse is not None and coarse.step <= COARSEST_STEP:
        # pixels share what is left of texture and light, which binning does not reduce; contacts are positive
        below = coarse.image[coarse.image < 0.0]
        scatter = max(noise / coarse.step, robust_std(below, centre=0.0) if below.size else 0.0)
        wide = _measure(coarse, DETECTION_SIGMA * scatter)
        if wide.resolved:
            return replace(wide, hidden=True)
        coarse = coarse.coarser()
    return found


def _measure(binned: BinnedImage, floor: float) -> Contrast:
    """Contrast of what exceeds a floor."""
    image, window = binned.image, max(CORE_PX // binned.step, LEAST_WINDOW)
    high = _stand_out(image, window, floor)
    if high.shape[1] < 4:
        return Contrast(0.0, resolved=False)
    plateau, level = _settle(high, floor)
    if _mixed(high, floor, plateau, level):
        high = _stand_out(_keep_usual_objects(image, max(FAINTEST_RATIO * plateau, floor)), window, floor)
        plateau, level = _settle(high, floor)
    resolved = bool(np.count_nonzero(high[AROUND] > level) >= LEAST_PLATEAU_PIXELS)
    std = _plateau_std(high, plateau, level) if resolved else UNRESOLVED_RELATIVE_STD * plateau
    return Contrast(plateau, resolved, std)


def _stand_out(image: NDArray[np.float32], window: int, floor: float) -> NDArray[np.float32]:
    """Pixels above the floor: value, and lowest value in the window around and in one wider by 2 px.

    A sample of the rows if there are many, unless hardly any of these pixels lies inside a contact.
    """
    around = cv2.erode(image, np.ones((window, window), np.uint8))
    wider = cv2.erode(around, np.ones((3, 3), np.uint8))
    above = image > np.float32(floor)
    every = max(int(np.count_nonzero(above)) // SAMPLE_PIXELS, 1)
    if every > 1 and np.count_nonzero(around[::every] > np.float32(floor)) < SAMPLE_PIXELS // 10:
        every = 1
    rows = slice(every // 2, None, every)
    return np.stack([part[rows][above[rows]] for part in (image, around, wider)])


def _settle(high: NDArray[np.float32], floor: float) -> tuple[float, np.float32]:
    """Plateau: the median of the pixels whose whole window reaches half of it; and that half."""
    plateau = quantile(high[VALUE], 0.95) if high.size else 0.0
    for _ in range(4):
        level = np.float32(max(0.5 * plateau, floor))
        values = high[VALUE][high[AROUND] > level]
        if len(values) < LEAST_PLATEAU_PIXELS:
            break
        previous, plateau = plateau, median(values)
        if abs(plateau - previous) < SETTLED_CHANGE * plateau:
            break
    return plateau, level


def _mixed(high: NDArray[np.float32], floor: float, plateau: float, level: np.float32) -> bool:
    """Whether the image has wide objects much brighter or much fainter than the plateau."""
    pixels, around, _ = high
    bright = (around > level) & (pixels > np.float32(BRIGHTER_RATIO * plateau))
    if np.count_nonzero(bright) >= LEAST_PLATEAU_PIXELS:
        return True
    low = pixels > np.float32(max(FAINTEST_RATIO * plateau, floor))
    low &= pixels < np.float32(FAINTER_RATIO * plateau)
    # level all around: neither the slope of a bright object nor one too small to show its brightness
    return bool(np.count_nonzero(low & (around > np.float32(LEVEL_RATIO) * pixels)) >= LEAST_PLATEAU_PIXELS)


def _keep_usual_objects(image: NDArray[np.float32], level: float) -> NDArray[np.float32]:
    """The image without long objects, and without those much brighter or fainter than most."""
    regions = label_regions(image, level)
    wide = ~regions.long & (regions.area >= WIDE_AREA)
    if not wide.any():
        wide = ~regions.long
    if not wide.any():
        return image
    usual = float(np.median(regions.peak[wide]))
    kept = wide & (regions.peak > FAINTER_RATIO * usual) & (regions.peak < BRIGHTER_RATIO * usual)
    return np.where(np.append(kept, np.False_)[regions.labels], image, np.float32(0.0))


def _plateau_std(high: NDArray[np.float32], plateau: float, level: np.float32) -> float:
    """Standard uncertainty of a plateau: its scatter, and how much it rises further inside the contacts."""
    values, core = (high[VALUE][high[window] > level] for window in (AROUND, WIDER))
    independent = max(len(values) / TEXTURE_CORRELATED_PIXELS, 1.0)
    rise = (median(core) if len(core) else float(values.max())) - plateau
    return float(np.hypot(MEDIAN_STD_RATIO * values.std() / np.sqrt(independent), rise))
