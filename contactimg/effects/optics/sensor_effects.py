"""Effects of the sensor: shot noise, read noise, quantisation, saturation."""

import numpy as np

from contactimg.effects.optics.sample_comparison import SampleComparison

QUANTISATION_VARIANCE = 1 / 12  # squared levels; theory: uniform distribution over one level
DITHER_LEVELS = 0.5  # chosen: with more noise the rounding error hardly depends on the signal
HEADROOM_SIGMA = 4.0  # noise below full scale that counts as reaching it; normal probability 3e-5 per pixel


def noise_variances(comparison: SampleComparison) -> dict[str, float]:
    """Variance of a pixel at half height of a contact by source, squared levels; 0 if not shown."""
    simulate = comparison.simulate
    electrons = simulate.electrons_per_level
    middle = max(simulate.background_levels + simulate.contrast_levels / 2, 0.0)
    variance = {
        "shot_noise": middle / electrons if electrons else 0.0,
        "read_noise": (simulate.read_noise_electrons / electrons) ** 2 if electrons else 0.0,
        "quantisation": QUANTISATION_VARIANCE,
    }
    return {name: value if name in comparison.base else 0.0 for name, value in variance.items()}


def noise_change(comparison: SampleComparison, effect: str) -> tuple[float, str]:
    """Shot or read noise: scatter of each radius, and contacts lost below the detection limit."""
    variance = noise_variances(comparison)
    if effect not in comparison.base:  # switched off: the change if it were added
        return noise_change(comparison.with_effect(effect), effect)
    total = sum(variance.values())
    contrast = abs(comparison.simulate.contrast_levels)
    change = comparison.noise_change(noise_shares(comparison), variance[effect] / total)
    lost = comparison.measurement().lost
    return change, (
        f"{np.sqrt(variance[effect]):.2g} of {np.sqrt(total):.2g} levels of noise at a contrast of "
        f"{contrast:.3g}; {lost:.0f} of {comparison.sample.weight.sum():.0f} contacts below detection"
    )


def quantisation_change(comparison: SampleComparison) -> tuple[float, str]:
    """Quantisation: additional noise if other noise is large enough, else a distortion."""
    if "quantisation" not in comparison.base:
        return quantisation_change(comparison.with_effect("quantisation"))
    variance = noise_variances(comparison)
    other = np.sqrt(variance["shot_noise"] + variance["read_noise"])
    contrast = abs(comparison.simulate.contrast_levels)
    reason = f"a contrast of {contrast:.3g} levels, {other:.2g} of other noise"
    if other < DITHER_LEVELS:
        return comparison.change("quantisation"), reason + ": too little for dither"
    return comparison.noise_change(
        noise_shares(comparison), QUANTISATION_VARIANCE / (other**2 + QUANTISATION_VARIANCE)
    ), reason


def noise_shares(comparison: SampleComparison) -> dict[str, float]:
    """Fraction of each source in the variance of the noise; empty without noise."""
    variance = noise_variances(comparison)
    total = sum(variance.values())
    return {name: value / total for name, value in variance.items()} if total else {}


def reaches_full_scale(comparison: SampleComparison) -> bool:
    """Whether a pixel of a contact can reach full scale or zero."""
    return _headroom(comparison) < 0


def saturation_change(comparison: SampleComparison) -> tuple[float, str]:
    """Saturation: full scale clips the plateau of the contacts."""
    simulate = comparison.simulate
    full_scale = 2**simulate.bit_depth - 1
    brightest = _brightest(comparison)
    reason = f"contacts of {brightest:.3g} levels under a full scale of {full_scale}"
    if _headroom(comparison) > 0:
        return 0.0, reason
    return comparison.change("saturation"), reason


def _brightest(comparison: SampleComparison) -> float:
    """Grey level of the brightest contact or background."""
    simulate = comparison.simulate
    drift = 1 + simulate.light_drift if "light_drift" in comparison.base else 1.0
    return drift * (simulate.background_levels + max(simulate.contrast_levels, 0.0))


def _headroom(comparison: SampleComparison) -> float:
    """Grey levels left between the brightest pixels and full scale, or the darkest and zero, after noise."""
    simulate = comparison.simulate
    noise = np.sqrt(sum(noise_variances(comparison).values()))
    margin = HEADROOM_SIGMA * noise + HEADROOM_SIGMA * simulate.texture * _brightest(comparison)
    darkest = simulate.background_levels + min(simulate.contrast_levels, 0.0)
    return float(min(2**simulate.bit_depth - 1 - _brightest(comparison), darkest) - margin)
