"""Effects on the edge of a contact in the image: blur, air film, roughness, and sampling by the renderer."""

import numpy as np

from contactimg.effects.optics.sample_comparison import SampleComparison
from contactimg.optics.film import Light, thick_transmission, transmission
from contactimg.optics.psf import MAX_SAMPLES_PER_PIXEL
from contactimg.optics.render_settings import lamp
from contactimg.optics.rough_edges import MAX_ROUGHNESS_FRACTION
from contactimg.scene import Simulate

NEGLIGIBLE_FRACTION = 0.1
"""Fraction of the tolerance below which an upper bound is used as the estimate. Chosen: it cannot decide."""

FILM_CONTRAST_FACTOR = 2.0
"""The film explains a contrast within this factor of its own. Chosen by hand; sensitivity not measured."""


def film_strength(light: Light) -> float:
    """Contrast of a contact against a thick air film, ``T(0)/T(inf) - 1``.

    Examples
    --------
    >>> film_strength(Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9)))
    0.0728
    """
    thick = thick_transmission(light)
    return float(transmission(0.0, light=light)) / thick - 1


def film_makes_the_contrast(simulate: Simulate) -> bool:
    """Whether the contrast of a scene is that of an air film, within `FILM_CONTRAST_FACTOR`.

    Otherwise it has another cause (for example caps that deflect the light), and the film does not shape the
    edge.

    Examples
    --------
    >>> film_makes_the_contrast(Simulate(background_levels=200.0, contrast_levels=15.0))
    True
    >>> film_makes_the_contrast(Simulate(background_levels=80.0, contrast_levels=100.0))
    False
    """
    ratio = simulate.contrast_levels / simulate.background_levels / film_strength(lamp(simulate))
    return 1 / FILM_CONTRAST_FACTOR <= ratio <= FILM_CONTRAST_FACTOR


def blur_change(comparison: SampleComparison) -> tuple[float, str]:
    """Blur reduces the height of small contacts and shifts their half-height contour."""
    sigma, radius = comparison.simulate.blur_px, comparison.sample.radius_px
    lost = comparison.measurement().lost - comparison.measurement(without="blur").lost
    least, most = radius.min(), radius.max()
    shift = (sigma**2 + 1 / 12) / (2 * comparison.mean_radius)
    read = (
        f"the half-height contour shifts by s^2/2a = {shift:.2g} px"
        if comparison.scene.measure.method == "threshold"
        else "the fit includes the blur"
    )
    reason = f"blur of {sigma:g} px on radii of {least:.2g} to {most:.2g} px; {read}; {max(lost, 0):.0f} lost"
    return comparison.change("blur"), reason


def film_change(comparison: SampleComparison) -> tuple[float, str]:
    """The air film brightens the surroundings of a contact if it causes the contrast."""
    simulate = comparison.simulate
    contrast = simulate.contrast_levels / simulate.background_levels
    strength = film_strength(lamp(simulate))
    stated = f"contrast {100 * contrast:.3g} % of the background, the film's {100 * strength:.2g} %"
    if not np.isfinite(comparison.sample.sphere_radius).all():
        return 0.0, f"the radii of curvature are not known; {stated}"
    if simulate.edge_softness_px > 0:
        return 0.0, "edge_softness_px replaces the edge of the film"
    switched_on = comparison.scene.effects.film == "on"
    if not switched_on and not film_makes_the_contrast(simulate):
        return 0.0, f"{stated}: the contrast has another cause"
    radius = comparison.mean_radius
    change = comparison.change("film")
    return change, f"{stated}; a halo around radii of {radius:.2g} px = {radius * comparison.pixel_um:.2g} um"


def roughness_change(comparison: SampleComparison) -> tuple[float, str]:
    """A rough edge keeps the area but reduces the mean radius, which the fit of a disk measures."""
    radius, weight = comparison.sample.radius_px, comparison.sample.weight
    relative = np.minimum(comparison.simulate.edge_roughness_px / radius, MAX_ROUGHNESS_FRACTION)
    # the area keeps sqrt(<r^2>), so <r> decreases by <(r - <r>)^2>/(2 r)
    most = comparison.power / 2 * float(np.average(relative**2, weights=weight * radius**comparison.power))
    reason = (
        f"edges deviate by up to {100 * relative.max():.2g} % of the radius; areas stay, mean "
        f"radii by {100 * relative.max() ** 2 / 2:.1g} %"
    )
    matters = most > NEGLIGIBLE_FRACTION * comparison.scene.tolerance.relative
    return comparison.change("edge_roughness") if matters else most, reason


def supersampling_change(comparison: SampleComparison) -> tuple[float, str]:
    """Error of the blur on a coarse grid.

    The coverage of cells is exact, so only the blur is sampled. With ``n`` cells per pixel the first alias of
    an edge changes the variance of the blur by ``cos(2 pi n x)/(pi^2 n^2)``, where ``x`` is the position of
    the edge in the cell. Around a contact this averages to ``J0(2 pi n a)/(pi^2 n^2)``, about ``1/(pi^3 n^2
    sqrt(n a))``. The half-height contour shifts by this value over ``2 a``, with random sign.
    """
    simulate = comparison.simulate
    if "blur" not in comparison.base:
        return 0.0, "without blur the coverage of each pixel is exact"
    depth = min(max(1.0, np.ceil(1 / simulate.blur_px)), MAX_SAMPLES_PER_PIXEL)
    a = comparison.sample.radius_px
    step = 1 / (np.pi**3 * depth**2 * np.sqrt(depth * a) * 2 * a)
    change = comparison.scattered(step / a)
    return change, f"blur of {simulate.blur_px:g} px spans {simulate.blur_px * depth:.2g} of the widest cells"
