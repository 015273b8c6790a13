"""Time that rendering needs for an effect: a formula fitted to timed frames of 0.2 to 2 million pixels.

Times are in ns on one core; only their ratios are used. The error is a factor of two to three at most in the
range timed.
"""

import math

import numpy as np

from contactimg.effects.optics.sample_comparison import SampleComparison
from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import lamp
from contactimg.scene import Scene

FRAME_PIXEL_NS, CONTACT_NS = 12.0, 1.5e5
"""Time per pixel and per contact without any effect."""

EFFECT_PIXEL_NS = {
    "vignetting": 6.0,
    "shot_noise": 32.0,
    "read_noise": 12.0,
    "quantisation": 2.0,
    "saturation": 2.0,
}
"""Additional time per pixel of the frame."""

BLUR_SAMPLE_NS = 90.0
"""Time per pixel that a contact and its blur cover, with one sample per pixel."""

FILM_PIXEL_NS = 1.2e4
"""Time per pixel that a contact and its air film cover."""

DUST_GRAIN_NS, DUST_PIXEL_NS = 4e4, 5.0
"""Time per grain of dust, and per pixel of a frame with dust."""

ROUGH_EDGE_NS = 6e4
"""Time per contact with a rough edge."""


def render_cost(effect: str, scene: Scene, comparison: SampleComparison | None) -> float:
    """Time to render a frame with the effect divided by the time without any effect.

    Parameters
    ----------
    effect : str
        An effect of optics or sensor.
    scene : Scene
        With a section ``[simulate]``.
    comparison : SampleComparison or None
        None if no contact lies in the frame.
    """
    simulate = scene.need("simulate", "the cost of rendering")
    pixels = math.prod(simulate.shape)
    extra = EFFECT_PIXEL_NS.get(effect, 0.0) * pixels
    contacts = 0.0
    if effect == "dust":
        extra = DUST_PIXEL_NS * pixels + DUST_GRAIN_NS * simulate.dust_count
    if comparison is not None:
        contacts = float(comparison.sample.weight.sum())
        extra += _contacts_cost(effect, comparison)
    return 1 + extra / (FRAME_PIXEL_NS * pixels + CONTACT_NS * contacts)


def _contacts_cost(effect: str, comparison: SampleComparison) -> float:
    """Additional time around the contacts, in ns."""
    simulate, sample = comparison.simulate, comparison.sample
    if effect == "edge_roughness":
        return ROUGH_EDGE_NS * float(sample.weight.sum())
    if effect == "film" and np.isfinite(sample.sphere_radius).all():
        reach = excess_table(lamp(simulate)).reach(
            radius=sample.radius_px * sample.pixel_size, sphere_radius=sample.sphere_radius
        )
        return FILM_PIXEL_NS * float(sample.weight @ (np.pi * (reach / sample.pixel_size) ** 2))
    lit = float(sample.weight @ (2 * sample.radius_px + 10 * simulate.blur_px + 2) ** 2)
    samples = {"blur": 1, "supersampling": simulate.supersampling**2 - 1}.get(effect, 0)
    return BLUR_SAMPLE_NS * samples * lit
