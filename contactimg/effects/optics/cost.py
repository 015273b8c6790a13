"""What an effect costs the renderer: a rule of thumb from timed frames of 0.2 to 2 million pixels.

Times in ns of one core; only their ratios are used. Off by no more than a factor of two or three in the range
timed.
"""

import math

import numpy as np

from contactimg.effects.optics.trial import Trial
from contactimg.optics.film import excess_table
from contactimg.optics.recipe import lamp
from contactimg.scene import Scene

FRAME, CONTACT = 12.0, 1.5e5
"""A frame without any effect: a pixel, and a contact."""

PIXEL = {"vignetting": 6.0, "shot_noise": 32.0, "read_noise": 12.0, "quantisation": 2.0, "saturation": 2.0}
"""Each pixel of the frame."""

SAMPLE = 90.0
"""Each pixel that a contact and its blur light up, at one sample a pixel."""

FILM_POINT = 1.2e4
"""Each pixel that a contact and its halo light up."""

GRAIN, GRAINS = 4e4, 5.0
"""A grain of dust, and each pixel."""

OUTLINE = 6e4
"""A contact with a rough edge."""


def render_cost(effect: str, scene: Scene, trial: Trial | None) -> float:
    """Time to render a frame with the effect over that of the cheapest one, without any.

    Parameters
    ----------
    effect : str
        One of optics and sensor.
    scene : Scene
        With a section ``[simulate]``.
    trial : Trial or None
        Its contacts; None without any in the frame.
    """
    simulate = scene.need("simulate", "the cost of rendering")
    pixels = math.prod(simulate.shape)
    extra = PIXEL.get(effect, 0.0) * pixels
    contacts = 0.0
    if effect == "dust":
        extra = GRAINS * pixels + GRAIN * simulate.dust_count
    if trial is not None:
        contacts = float(trial.strip.weight.sum())
        extra += _contacts_cost(effect, trial)
    return 1 + extra / (FRAME * pixels + CONTACT * contacts)


def _contacts_cost(effect: str, trial: Trial) -> float:
    """What the effect costs around the contacts, ns."""
    simulate, strip = trial.simulate, trial.strip
    if effect == "edge_roughness":
        return OUTLINE * float(strip.weight.sum())
    if effect == "film" and np.isfinite(strip.sphere_radius).all():
        reach = excess_table(lamp(simulate)).reach(
            radius=strip.radius_px * strip.pixel_size, sphere_radius=strip.sphere_radius
        )
        return FILM_POINT * float(strip.weight @ (np.pi * (reach / strip.pixel_size) ** 2))
    lit = float(strip.weight @ (2 * strip.radius_px + 10 * simulate.blur_px + 2) ** 2)
    samples = {"blur": 1, "supersampling": simulate.supersampling**2 - 1}.get(effect, 0)
    return SAMPLE * samples * lit
