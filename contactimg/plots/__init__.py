"""Draw figures: tables in, matplotlib axes out; ``ax=`` draws on existing axes.

Lengths are in um or mm, forces in mN, areas in mm^2, moduli and shear stresses in MPa, pressures in kPa.
Read in this order: `images` and `overlay` (contacts on frames), `laws` (with residuals) and `curves`
(analysis), `calibration`, `tradeoff`, `captions`, `numbers`, `axes`.
"""

from contactimg.plots.axes import new_axes, scale_by_decades
from contactimg.plots.calibration import (
    plot_forces,
    plot_jkr,
    plot_jkr_residuals,
    plot_plateau,
    plot_slopes,
)
from contactimg.plots.captions import CAPTIONS, caption_of
from contactimg.plots.curves import plot_pressure_law, plot_profile, plot_topography
from contactimg.plots.images import (
    COUPLED,
    HERTZ,
    MEASURED,
    UNCOUPLED,
    crop_to,
    plot_circles,
    plot_image,
)
from contactimg.plots.laws import plot_area, plot_area_residuals, plot_areas, plot_friction

__all__ = [
    "CAPTIONS",
    "COUPLED",
    "HERTZ",
    "MEASURED",
    "UNCOUPLED",
    "caption_of",
    "crop_to",
    "new_axes",
    "plot_area",
    "plot_area_residuals",
    "plot_areas",
    "plot_circles",
    "plot_forces",
    "plot_friction",
    "plot_image",
    "plot_jkr",
    "plot_jkr_residuals",
    "plot_plateau",
    "plot_pressure_law",
    "plot_profile",
    "plot_slopes",
    "plot_topography",
    "scale_by_decades",
]
