"""Effects of illumination and position: vignetting, drifts of light and position, dust.

The measurement divides by the aligned reference, which removes uneven illumination, drift and dust. What
remains is their effect on the noise, on saturation, and at the border of the frame.
"""

import numpy as np
from scipy import special

from contactimg.effects.optics.sample_comparison import SampleComparison
from contactimg.effects.optics.sensor_effects import noise_shares, reaches_full_scale
from contactimg.effects.output_change import POWER
from contactimg.optics.synthetic_background import DUST_OPACITY, DUST_RADIUS_PX

FAINT_LIGHT_FRACTION = (
    0.1  # of the central light; chosen: below it the division by the reference is incomplete
)
DUST_RESIDUAL_FRACTION = (
    0.25  # of the shadow of dust, after division; chosen by hand, sensitivity not measured
)


def vignetting_change(comparison: SampleComparison) -> tuple[float, str]:
    """Vignetting: contacts in the darker corners have more relative noise and saturate less."""
    corner, light = (
        1 - comparison.simulate.vignetting,
        1 - comparison.simulate.vignetting * comparison.sample.off_axis,
    )
    reason = f"the light falls to {corner:.2g} in the corners, {light.min():.2g} at a contact"
    if reaches_full_scale(comparison):
        return comparison.change("vignetting"), reason + "; full scale is reached"
    if light.min() < FAINT_LIGHT_FRACTION:
        return comparison.change("vignetting"), reason + ": too dark to divide out"
    return _by_noise(
        comparison, float(np.average(light, weights=comparison.sample.weight))
    ), reason + "; divided out"


def light_drift_change(comparison: SampleComparison) -> tuple[float, str]:
    """Light drift: divided out, except for its effect on noise and saturation."""
    drift = comparison.simulate.light_drift
    reason = f"{100 * drift:.2g} % more light than in the reference"
    if reaches_full_scale(comparison):
        return comparison.change("light_drift"), reason + "; full scale is reached"
    return _by_noise(comparison, 1 + drift), reason + "; divided out"


def _by_noise(comparison: SampleComparison, light: float) -> float:
    """Change of the output by the shot noise at a relative light level."""
    shares = noise_shares(comparison)
    if not shares.get("shot_noise"):
        return 0.0
    return comparison.noise_change(shares, shares["shot_noise"] * min(abs(1 / light - 1), 1.0), scatter=0.0)


def position_drift_change(comparison: SampleComparison) -> tuple[float, str]:
    """Position drift: the alignment corrects it, but contacts enter and leave at the border of the frame."""
    sigma, shape = comparison.simulate.position_drift_px, comparison.simulate.shape
    pose, contacts = comparison.scene.pose(shape), comparison.contacts
    x, y = pose.to_pixels(contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float))
    amount = contacts["radius_m"].to_numpy(float) ** comparison.power
    shown = np.ones(len(contacts))
    inside = np.ones(len(contacts))
    for place, length in ((x, shape[1]), (y, shape[0])):
        low, high = (-0.5 - place) / sigma, (length - 0.5 - place) / sigma
        shown *= special.ndtr(high) - special.ndtr(low)
        inside *= (low < 0) & (high > 0)
    step = amount * (shown - inside)
    if comparison.power == POWER["radius"]:
        change = np.sqrt(np.sum(step**2) / max(np.sum((amount * inside) ** 2), 1e-300))
    else:
        change = abs(step.sum()) / max(float(amount @ inside), 1e-300)
    leaving = float(np.sum(np.maximum(inside - shown, 0.0)))
    reason = f"{sigma:.2g} px, corrected; {leaving:.2g} of {inside.sum():.0f} contacts leave the frame"
    return float(change), reason


def dust_change(comparison: SampleComparison) -> tuple[float, str]:
    """Dust on contacts: the reference shows it too, so most of the shadow is divided out."""
    low, high = DUST_RADIUS_PX
    shadow = np.pi * (high**2 - low**2) / (2 * np.log(high / low)) * np.mean(DUST_OPACITY)
    covered = comparison.simulate.dust_count * shadow / np.prod(comparison.simulate.shape)
    change = DUST_RESIDUAL_FRACTION * covered * comparison.power / 2
    grains = comparison.simulate.dust_count
    return float(change), f"{grains} grains shade {100 * covered:.2g} % of the frame, mostly divided out"
