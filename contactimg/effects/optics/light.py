"""Light and place of the frame: uneven light, drifts of light and of position, dust.

The measurement divides by the registered reference, which takes uneven light, drift and dust out of the
picture; what stays is what they do to the noise, to the end of the scale, and at the border of the frame.
"""

import numpy as np
from scipy import special

from contactimg.effects.change import POWER
from contactimg.effects.optics.sensor import noise_shares, reaches_full_scale
from contactimg.effects.optics.trial import Trial
from contactimg.optics.static import DUST_OPACITY, DUST_RADIUS_PX

FAINT = 0.1  # of the central light: where less is left the measurement does not divide by all of it
DUST_LEFT = 0.25  # of the light that dust takes from a contact: what the reference does not give back


def vignetting_change(trial: Trial) -> tuple[float, str]:
    """Uneven light: darker corners are noisier, a darker contact saturates less."""
    corner, light = 1 - trial.simulate.vignetting, 1 - trial.simulate.vignetting * trial.strip.off_axis
    reason = f"the light falls to {corner:.2g} in the corners, {light.min():.2g} at a contact"
    if reaches_full_scale(trial):
        return trial.change("vignetting"), reason + "; full scale is reached"
    if light.min() < FAINT:
        return trial.change("vignetting"), reason + ": hardly seen"
    return _by_noise(trial, float(np.average(light, weights=trial.strip.weight))), reason + "; divided out"


def light_drift_change(trial: Trial) -> tuple[float, str]:
    """Another exposure than the reference's: divided out, up to noise and full scale."""
    drift = trial.simulate.light_drift
    reason = f"{100 * drift:.2g} % more light than in the reference"
    if reaches_full_scale(trial):
        return trial.change("light_drift"), reason + "; full scale is reached"
    return _by_noise(trial, 1 + drift), reason + "; divided out"


def _by_noise(trial: Trial, light: float) -> float:
    """Change of the output because so much light, relative, carries another relative noise: shots alone."""
    shares = noise_shares(trial)
    if not shares.get("shot_noise"):
        return 0.0
    return trial.noise_change(shares, shares["shot_noise"] * min(abs(1 / light - 1), 1.0), scatter=0.0)


def position_drift_change(trial: Trial) -> tuple[float, str]:
    """The sample moves under the camera: registered, but contacts come and go at the border of the frame."""
    sigma, shape = trial.simulate.position_drift_px, trial.simulate.shape
    pose, contacts = trial.scene.pose(shape), trial.contacts
    x, y = pose.to_pixels(contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float))
    amount = contacts["radius_m"].to_numpy(float) ** trial.power
    shown = np.ones(len(contacts))
    inside = np.ones(len(contacts))
    for place, length in ((x, shape[1]), (y, shape[0])):
        low, high = (-0.5 - place) / sigma, (length - 0.5 - place) / sigma
        shown *= special.ndtr(high) - special.ndtr(low)
        inside *= (low < 0) & (high > 0)
    step = amount * (shown - inside)
    if trial.power == POWER["radius"]:
        change = np.sqrt(np.sum(step**2) / max(np.sum((amount * inside) ** 2), 1e-300))
    else:
        change = abs(step.sum()) / max(float(amount @ inside), 1e-300)
    leaving = float(np.sum(np.maximum(inside - shown, 0.0)))
    return float(
        change
    ), f"{sigma:.2g} px, registered; {leaving:.2g} of {inside.sum():.0f} contacts leave the frame"


def dust_change(trial: Trial) -> tuple[float, str]:
    """Grains on contacts: the reference shows them too, so that a part of their shadow is given back."""
    low, high = DUST_RADIUS_PX
    shadow = np.pi * (high**2 - low**2) / (2 * np.log(high / low)) * np.mean(DUST_OPACITY)
    covered = trial.simulate.dust_count * shadow / np.prod(trial.simulate.shape)
    change = DUST_LEFT * covered * trial.power / 2
    return float(
        change
    ), f"{trial.simulate.dust_count} grains shade {100 * covered:.2g} % of the frame, mostly divided out"
