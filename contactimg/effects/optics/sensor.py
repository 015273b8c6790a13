"""The sensor: noise of shots and read-out, whole numbers, the end of the scale."""

import numpy as np

from contactimg.effects.optics.trial import Trial

ROUNDING = 1 / 12  # variance of rounding to whole levels
DITHERED = 0.5  # levels of other noise that make rounding one more noise; below, it is a distortion
TAIL = 4.0  # standard deviations


def variances(trial: Trial) -> dict[str, float]:
    """Variance of a pixel half way up a contact, squared levels, by source; 0 for what is not shown."""
    simulate = trial.simulate
    electrons = simulate.electrons_per_level
    middle = max(simulate.background_levels + simulate.contrast_levels / 2, 0.0)
    found = {
        "shot_noise": middle / electrons if electrons else 0.0,
        "read_noise": (simulate.read_noise_electrons / electrons) ** 2 if electrons else 0.0,
        "quantisation": ROUNDING,
    }
    return {name: value if name in trial.base else 0.0 for name, value in found.items()}


def noise_change(trial: Trial, effect: str) -> tuple[float, str]:
    """Shots or read-out: scatter of each radius, and contacts lost below the limit of detection."""
    found = variances(trial)
    if effect not in trial.base:  # off by order: what it would do to what is there
        return noise_change(trial.with_effect(effect), effect)
    total = sum(found.values())
    contrast = abs(trial.simulate.contrast_levels)
    change = trial.noise_change(noise_shares(trial), found[effect] / total)
    lost = trial.reading().lost
    return change, (
        f"{np.sqrt(found[effect]):.2g} of {np.sqrt(total):.2g} levels of noise at a contrast of "
        f"{contrast:.3g}; {lost:.0f} of {trial.strip.weight.sum():.0f} contacts below detection"
    )


def quantisation_change(trial: Trial) -> tuple[float, str]:
    """Whole levels: one more noise under enough noise, a distortion without."""
    if "quantisation" not in trial.base:
        return quantisation_change(trial.with_effect("quantisation"))
    found = variances(trial)
    other = np.sqrt(found["shot_noise"] + found["read_noise"])
    contrast = abs(trial.simulate.contrast_levels)
    reason = f"a contrast of {contrast:.3g} levels, {other:.2g} of other noise"
    if other < DITHERED:
        return trial.change("quantisation"), reason + ": too little to blur the steps"
    return trial.noise_change(noise_shares(trial), ROUNDING / (other**2 + ROUNDING)), reason


def noise_shares(trial: Trial) -> dict[str, float]:
    """Share of each source of noise in the variance; empty without noise."""
    found = variances(trial)
    total = sum(found.values())
    return {name: value / total for name, value in found.items()} if total else {}


def reaches_full_scale(trial: Trial) -> bool:
    """Whether a pixel of a contact may reach full scale, or black."""
    return _headroom(trial) < 0


def saturation_change(trial: Trial) -> tuple[float, str]:
    """The end of the scale cuts the plateau of the contacts."""
    simulate = trial.simulate
    full_scale = 2**simulate.bit_depth - 1
    brightest = _brightest(trial)
    reason = f"contacts of {brightest:.3g} levels under a full scale of {full_scale}"
    if _headroom(trial) > 0:
        return 0.0, reason
    return trial.change("saturation"), reason


def _brightest(trial: Trial) -> float:
    """Level of the brightest contact or background."""
    simulate = trial.simulate
    drift = 1 + simulate.light_drift if "light_drift" in trial.base else 1.0
    return drift * (simulate.background_levels + max(simulate.contrast_levels, 0.0))


def _headroom(trial: Trial) -> float:
    """Levels between full scale and the brightest pixels, or black and the darkest, noise included."""
    simulate = trial.simulate
    noise = TAIL * np.sqrt(sum(variances(trial).values())) + TAIL * simulate.texture * _brightest(trial)
    darkest = simulate.background_levels + min(simulate.contrast_levels, 0.0)
    return float(min(2**simulate.bit_depth - 1 - _brightest(trial), darkest) - noise)
