"""Number and area of the contacts of one frame against the threshold."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactimg.calibration.plateau import find_plateau
from contactimg.errors import InputError
from contactimg.imaging.measure import count_again
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.pipeline.calibrate.threshold_scan import THRESHOLDS, count_at
from contactimg.review.frame_light import FrameLight

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ThresholdCurves:
    """One frame counted at many thresholds.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
        Fractions of the contrast.
    counts, areas : ndarray, shape (m,)
        Number of contacts and their area, px^2, by `process` with the method "threshold" and the edits.
    scanned_areas : ndarray, shape (m,)
        Area, px^2, that `calibrate threshold` and `calibrate plateau` see: without edits and second look.
    plateau : (float, float, float) or None
        Lowest threshold, threshold of the slowest fall, and highest threshold of the plateau of this frame.
    """

    thresholds: Values
    counts: Values
    areas: Values
    scanned_areas: Values
    plateau: tuple[float, float, float] | None

    @classmethod
    def of(
        cls, light: FrameLight, edits: Sequence[HandEdit] = (), *, thresholds: Values = THRESHOLDS
    ) -> "ThresholdCurves":
        """Count a frame with corrections of its contacts."""
        counts, areas, scanned = [], [], []
        holes = ~np.isfinite(light.frame.image) if light.frame.image.dtype.kind == "f" else None
        for fraction in thresholds.tolist():
            disks = count_again(light.prepared, fraction, edits=edits).disks
            counts.append(len(disks))
            areas.append(_area(disks["radius_px"].to_numpy(float)))
            again = count_at(light.counted, fraction, holes=holes) if light.counted.contrast else disks
            scanned.append(_area(again["radius_px"].to_numpy(float)))
        return cls(
            thresholds, np.array(counts), np.array(areas), np.array(scanned), _plateau(thresholds, scanned)
        )

    def record(self, pixel_size: float | None) -> dict[str, Any]:
        """For the page; areas in m^2 where the pixel size (m) is known, else in px^2."""
        factor = 1.0 if pixel_size is None else pixel_size**2
        return {
            "thresholds": self.thresholds.tolist(),
            "counts": self.counts.tolist(),
            "areas": (self.areas * factor).tolist(),
            "scanned_areas": (self.scanned_areas * factor).tolist(),
            "unit": "px2" if pixel_size is None else "m2",
            "plateau": self.plateau,
        }


def _area(radius: Values) -> float:
    """Sum over disks."""
    return float(np.pi * np.sum(radius**2))


def _plateau(thresholds: Values, areas: list[float]) -> tuple[float, float, float] | None:
    """The plateau of one frame; None where there is none."""
    try:
        found = find_plateau(thresholds, areas)
    except InputError:
        return None
    return found.threshold_low, found.threshold, found.threshold_high
