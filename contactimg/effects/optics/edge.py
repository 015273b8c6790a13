"""The edge of a contact in the picture: blur, air film, roughness, and how finely the renderer samples it."""

import numpy as np

from contactimg.effects.optics.trial import Trial
from contactimg.optics.film import Light, thick_transmission, transmission
from contactimg.optics.outlines import ROUGHEST
from contactimg.optics.psf import FINEST
from contactimg.optics.recipe import lamp
from contactimg.scene import Simulate

HARMLESS = 0.1
"""Of the tolerance: bounds below that need not be looked at more closely."""

LIKE_THE_FILM = 2.0
"""A contrast within this factor of the film's own is the film's; another one is made by other light."""


def film_strength(light: Light) -> float:
    """By how much a contact outshines a thick film, relative to the film: ``T(0)/T(inf) - 1``.

    Examples
    --------
    >>> film_strength(Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9)))
    0.0728
    """
    thick = thick_transmission(light)
    return float(transmission(0.0, light=light)) / thick - 1


def film_makes_the_contrast(simulate: Simulate) -> bool:
    """Whether the contrast that a scene states is what its light gives an air film, within a factor of two.

    Otherwise other light makes it, that of caps which deflect it say, and the film does not know its edge.

    Examples
    --------
    >>> film_makes_the_contrast(Simulate(background_levels=200.0, contrast_levels=15.0))
    True
    >>> film_makes_the_contrast(Simulate(background_levels=80.0, contrast_levels=100.0))
    False
    """
    ratio = simulate.contrast_levels / simulate.background_levels / film_strength(lamp(simulate))
    return 1 / LIKE_THE_FILM <= ratio <= LIKE_THE_FILM


def blur_change(trial: Trial) -> tuple[float, str]:
    """Blur lowers small contacts and moves the level at which pixels count."""
    sigma, radius = trial.simulate.blur_px, trial.strip.radius_px
    lost = trial.reading().lost - trial.reading(without="blur").lost
    least, most = radius.min(), radius.max()
    shift = (sigma**2 + 1 / 12) / (2 * trial.mean_radius)
    read = (
        f"half height moves by s^2/2a = {shift:.2g} px"
        if trial.scene.measure.method == "threshold"
        else "the fit finds the blur"
    )
    reason = f"blur of {sigma:g} px on radii of {least:.2g} to {most:.2g} px; {read}; {max(lost, 0):.0f} lost"
    return trial.change("blur"), reason


def film_change(trial: Trial) -> tuple[float, str]:
    """The air film brightens the surroundings of a contact, where it makes the contrast."""
    simulate = trial.simulate
    contrast = simulate.contrast_levels / simulate.background_levels
    strength = film_strength(lamp(simulate))
    stated = f"contrast {100 * contrast:.2g} % of the background, the film's {100 * strength:.2g} %"
    if not np.isfinite(trial.strip.sphere_radius).all():
        return 0.0, f"the radii of curvature are not known; {stated}"
    if simulate.edge_softness_px > 0:
        return 0.0, "edge_softness_px gives the edge another form"
    ordered = trial.scene.effects.film == "on"
    if not ordered and not film_makes_the_contrast(simulate):
        return 0.0, f"{stated}: other light makes the contrast"
    radius = trial.mean_radius
    change = trial.change("film")
    return change, f"{stated}; a halo around radii of {radius:.2g} px = {radius * trial.pixel_um:.2g} um"


def roughness_change(trial: Trial) -> tuple[float, str]:
    """A rough edge of unchanged area: its mean radius, which a disk fit finds, is smaller."""
    radius, weight = trial.strip.radius_px, trial.strip.weight
    relative = np.minimum(trial.simulate.edge_roughness_px / radius, ROUGHEST)
    # sqrt(<r^2>) is kept, so <r> is less by <(r - <r>)^2>/(2 r)
    most = trial.power / 2 * float(np.average(relative**2, weights=weight * radius**trial.power))
    reason = (
        f"edges wander by up to {100 * relative.max():.2g} % of the radius; areas are kept, mean radii less "
        f"by {100 * relative.max() ** 2 / 2:.1g} %"
    )
    matters = most > HARMLESS * trial.scene.tolerance.relative
    return trial.change("edge_roughness") if matters else most, reason


def supersampling_change(trial: Trial) -> tuple[float, str]:
    """What a coarse grid leaves out.

    The coverage of cells is exact, so only the blur is sampled. At ``n`` cells a pixel the first alias of an
    edge changes the variance of the blur by ``cos(2 pi n x)/(pi^2 n^2)`` with the place ``x`` of the edge in
    the cell, which averages to ``1/(pi^2 n^2) J0(2 pi n a)`` around a contact, about ``1/(pi^3 n^2 sqrt(n
    a))``; half height moves by that over ``2 a``, up and down at random.
    """
    simulate = trial.simulate
    if "blur" not in trial.base:
        return 0.0, "without blur the coverage of each pixel is exact at any depth"
    depth = min(max(1.0, np.ceil(1 / simulate.blur_px)), FINEST)
    a = trial.strip.radius_px
    step = 1 / (np.pi**3 * depth**2 * np.sqrt(depth * a) * 2 * a)
    change = trial.scattered(step / a)
    return change, f"blur of {simulate.blur_px:g} px spans {simulate.blur_px * depth:.2g} of the widest cells"
