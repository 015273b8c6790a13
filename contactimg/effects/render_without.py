"""By how much each effect of optics and sensor changes what is measured: rendered with it and without.

The scene's contacts are rendered with all effects and without one of them, under the same noise, and measured
as ``[measure]`` says. Of many contacts only a part is rendered: the quarter about their median place that
holds the most, cropped to them.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.output_change import POWER, EffectEstimate, measured_outputs
from contactimg.effects.solve_without import MECHANICAL_EFFECTS
from contactimg.imaging.fit.film_choice import film_makes_contrast
from contactimg.imaging.measure import CORRECTIONS, LINEARITY, ImageMeasurement, measure_image
from contactimg.imaging.profile.film_rim import FilmRim
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.optics.render_settings import PARAMETER, lamp, rendered_effects
from contactimg.optics.sensor import digitise
from contactimg.render import render_contacts, render_reference
from contactimg.scene import Effects, Scene, Simulate
from contactimg.tables import CONTACTS

Values = NDArray[np.float64]
Shown = frozenset[str]

OPTICS = tuple(name for name in Effects.model_fields if name not in {"model", *MECHANICAL_EFFECTS})

NOISE = ("shot_noise", "read_noise", "quantisation")
"""Effects whose change is the root mean square over realisations; of all others it is the mean."""

SENSOR = frozenset((*NOISE, "saturation"))
"""Effects on the numbers of the sensor, after the light of the frame is known."""

REALISATIONS = 2
"""Realisations of the noise. Chosen to bound the time."""

FEWEST_CONTACTS = 40
"""Contacts that a quarter of the frame holds at least where it stands for the whole. Chosen by hand."""

MARGIN_PX = 30.0
"""Background around the contacts of the part. Chosen: four blocks of the estimate of the background."""

SHARP_BLUR_PX = 1e-3
"""Blur of a frame that is known to have none: small against the width of the pixel. Chosen: any value well
below 0.3 px, the standard deviation of a pixel, gives the same edge."""

NO_FILM = "no film:"

SEED = 20150203


def measuring(
    scene: Scene, full_scale: float | None, optics: SharedOptics | None = None
) -> Callable[..., ImageMeasurement]:
    """`contactimg.imaging.measure.measure_image` as a scene says: method, polarity, optics and corrections.

    Every command measures frames this way: a number calibrated on frames applies only to frames that were
    measured alike. Under "auto" a correction is on; an effect that is "off" is not corrected: shift, dust,
    saturated pixels, blur (the fit then assumes a sharp edge). Vignetting, drift of the light, noise,
    quantisation and rough edges are always measured or divided out.

    ``full_scale`` is that of a frame (grey levels), ``optics`` what other frames tell of it.
    """
    measure, own = scene.measure, optics or SharedOptics()
    sharp = SHARP_BLUR_PX if scene.effects.blur == "off" else None
    return partial(
        measure_image,
        method=measure.method,
        polarity=scene.images.polarity,
        threshold=measure.threshold,
        threshold_std=measure.threshold_std,
        full_scale=np.inf if scene.effects.saturation == "off" else full_scale,
        blur_px=sharp if measure.blur_px is None else measure.blur_px,
        optics=own.with_edge(measure.edge_shift_px, measure.edge_shift_std_px),
        shape=measure.shape,
        registration=measure.registration,
        absent=scene.effects.switched_off(*CORRECTIONS),
        linearity=scene.camera.linearity if scene.camera else LINEARITY,
    )


def film_rim(simulate: Simulate) -> FilmRim:
    """A rim under the light of a scene, of which only the contrast counts."""
    return FilmRim(lamp(simulate), sphere_radius=1.0, pixel_size=1.0)


def busiest_quarter(places: Values, shown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The quarter of a frame about the median place of some contacts that holds the most of them.

    It holds contacts from the middle of the loaded region to its rim, and so of all sizes.

    Parameters
    ----------
    places : ndarray, shape (2, n)
        Of contacts.
    shown : ndarray of bool, shape (n,)
        Which of them count; where the quarter holds fewer than `FEWEST_CONTACTS`, all these are taken.
    """
    below, right = places >= np.median(places[:, shown], axis=1, keepdims=True)
    quarters = [shown & (right == one) & (below == two) for one in (True, False) for two in (True, False)]
    chosen = max(quarters, key=np.count_nonzero)
    return chosen if np.count_nonzero(chosen) >= FEWEST_CONTACTS else shown


def _sphere_radii(scene: Scene, contacts: pd.DataFrame) -> Values:
    """Radius of curvature of each contact by Hertz's law, ``R = 4 E* a^3/(3 p)``; NaN where not known."""
    force, radius = contacts["force_N"].to_numpy(float), contacts["radius_m"].to_numpy(float)
    if scene.elastic is None:
        return np.full(len(contacts), np.nan)
    cubed = 4 / 3 * scene.elastic.contact_modulus * radius**3
    return np.divide(cubed, force, out=np.full(len(contacts), np.nan), where=force > 0)


class Camera:
    """Photographs a part of a scene with any choice of effects and measures it; results are kept.

    Parameters
    ----------
    scene : Scene
        Of the part.
    contacts : DataFrame
        In px.
    sphere_radius : ndarray, m
        Their radii of curvature.
    """

    def __init__(self, scene: Scene, contacts: pd.DataFrame, sphere_radius: Values) -> None:
        self.scene, self.contacts, self.sphere_radius = scene, contacts, sphere_radius
        self.simulate: Simulate = scene.need("simulate", "the effects of optics and sensor")
        self.noise = np.random.default_rng([SEED, 1]).standard_normal(
            (REALISATIONS, 4, *self.simulate.shape), dtype=np.float32
        )
        self.lights: dict[Shown, tuple[NDArray, NDArray]] = {}
        self.radii: dict[Shown, list[tuple[NDArray[np.intp], Values]]] = {}
        self.clipped = False

    @classmethod
    def of(cls, scene: Scene, contacts: pd.DataFrame) -> "Camera | None":
        """The camera over the contacts in the frame, or those of a quarter of it; None without any."""
        simulate = scene.need("simulate", "the effects of optics and sensor")
        pose, shape = scene.pose(simulate.shape), np.array(simulate.shape)
        x, y = pose.to_pixels(contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float))
        radius = contacts["radius_m"].to_numpy(float) / pose.pixel_size
        chosen = (x >= -0.5) & (x <= shape[1] - 0.5) & (y >= -0.5) & (y <= shape[0] - 0.5) & (radius > 0)
        if not chosen.any():
            return None
        chosen = busiest_quarter(np.array([y, x]), chosen)
        part, around = np.array([y, x])[:, chosen], float(radius[chosen].max()) + MARGIN_PX
        low = np.maximum(part.min(axis=1) - around, 0.0).astype(int)
        high = np.minimum((part.max(axis=1) + around).astype(int) + 1, shape)
        table = pd.DataFrame(
            {"x_px": x[chosen] - low[1], "y_px": y[chosen] - low[0], "radius_px": radius[chosen]}
        )
        middle = (shape - 1) / 2
        corners = np.maximum(np.abs(low - middle), np.abs(high - 1 - middle))
        farther = corners @ corners / max(middle @ middle, 1.0)
        changed = {
            "shape": tuple(int(n) for n in high - low),
            "dust_count": round(simulate.dust_count * float(np.prod((high - low) / shape))),
            "vignetting": simulate.vignetting * min(float(farther), 1.0),
        }
        smaller = scene.model_copy(update={"simulate": simulate.model_copy(update=changed)})
        return cls(smaller, CONTACTS.conform(table), _sphere_radii(scene, contacts)[chosen])

    def light(self, shown: Shown) -> tuple[NDArray, NDArray]:
        """Grey levels of frame and reference before the sensor."""
        key = shown - SENSOR
        if key not in self.lights:
            scene = self.scene.with_effects({name: "on" if name in key else "off" for name in OPTICS})
            radii, rng = self.sphere_radius if "film" in key else None, np.random.default_rng(SEED)
            frame = render_contacts(self.contacts, scene, rng=rng, sphere_radius=radii).frame.image
            self.lights[key] = frame, render_reference(scene, rng=np.random.default_rng(SEED)).image
        return self.lights[key]

    def record(self, levels: NDArray, shown: Shown, noise: NDArray) -> NDArray:
        """The pixels of the sensor; shot noise is normal, so that the light does not change its pattern."""
        simulate, levels = self.simulate, np.maximum(levels, 0.0)
        noisy = levels
        if "shot_noise" in shown:
            noisy = noisy + np.sqrt(levels / simulate.electrons_per_level) * noise[0]
        if "read_noise" in shown:
            noisy = noisy + simulate.read_noise_electrons / simulate.electrons_per_level * noise[1]
        self.clipped |= bool(noisy.min() < 0 or noisy.max() > 2**simulate.bit_depth - 1)
        switches = {"saturate": "saturation" in shown, "quantise": "quantisation" in shown}
        return digitise(noisy, bit_depth=simulate.bit_depth, **switches, name="part").image

    def measure(self, shown: Shown) -> list[tuple[NDArray[np.intp], Values]]:
        """The nearest contact of every measured disk and the disk's radius, px, for each realisation."""
        if shown in self.radii:
            return self.radii[shown]
        frame, reference = self.light(shown)
        full_scale = 2.0**self.simulate.bit_depth - 1 if "saturation" in shown else None
        measure, found = measuring(self.scene, full_scale), []
        x, y, a = (self.contacts[name].to_numpy(float) for name in ("x_px", "y_px", "radius_px"))
        for noise in self.noise:
            pair = self.record(frame, shown, noise[:2]), self.record(reference, shown, noise[2:])
            disks = measure(*pair).disks
            at_x, at_y, radius = (disks[name].to_numpy(float) for name in ("x_px", "y_px", "radius_px"))
            outside = np.hypot(at_x[:, None] - x, at_y[:, None] - y) - a
            found.append((outside.argmin(axis=1), radius))
        return self.radii.setdefault(shown, found)

    def amounts(self, shown: Shown, power: int) -> Values:
        """Measured ``a^power`` of each contact, one row a realisation; 0 if it was not detected."""
        n = len(self.contacts)
        return np.array([np.bincount(nearest, radius**power, n) for nearest, radius in self.measure(shown)])

    def change(self, output: str, effect: str, base: Shown) -> float:
        """Relative change of an output if the effect is left out."""
        complete = self.amounts(base | {effect}, POWER[output])
        step = self.amounts(base - {effect}, POWER[output]) - complete
        R = self.sphere_radius
        value = 1 / R if output == "force" and np.isfinite(R).all() else np.ones(R.size)
        step, mean = value * step, value * complete.mean(axis=0)
        if output == "radius":
            size = float(np.sum(mean**2))
            systematic, noise = float(np.sum(step.mean(axis=0) ** 2)), float(np.sum(step**2)) / len(step)
        else:
            total, size = step.sum(axis=1), float(mean.sum()) ** 2
            systematic = float(total.mean()) ** 2
            # the same number twice if contacts err independently; one alone scatters with few realisations
            noise = float(np.mean(total**2) + np.sum(step**2) / len(step)) / 2
        chance = float(step.var(axis=0, ddof=1).sum()) / len(step)
        square = noise if effect in NOISE else max(systematic - chance, 0.0)
        return float(np.sqrt(square / size)) if size > 0 else float(square > 0)


def _film_reason(camera: Camera) -> str:
    """The contrast of the scene and that of the film; ends with why the film cannot act."""
    simulate = camera.simulate
    contrast, rim = simulate.contrast_levels / simulate.background_levels, film_rim(simulate)
    stated = f"contrast {100 * contrast:.3g} % of the background, the film's {100 * rim.contrast:.2g} %"
    if not np.isfinite(camera.sphere_radius).all():
        return f"{stated}, {NO_FILM} the radii of curvature are not known"
    if simulate.edge_softness_px > 0:
        return f"{stated}, {NO_FILM} edge_softness_px replaces its edge"
    # such as caps that deflect the light: the film then does not shape the edge
    if camera.scene.effects.film != "on" and not film_makes_contrast(rim, contrast):
        return f"{stated}, {NO_FILM} the contrast has another cause"
    return stated


def _reason(effect: str, camera: Camera) -> str:
    """The number that decides on an effect, in words."""
    simulate, radius = camera.simulate, camera.contacts["radius_px"]
    if effect == "film":
        return _film_reason(camera)
    if effect in NOISE:
        middle = max(simulate.background_levels + simulate.contrast_levels / 2, 0.0)
        electrons = simulate.electrons_per_level or 1.0
        levels = {
            "shot_noise": float(np.sqrt(middle / electrons)),
            "read_noise": simulate.read_noise_electrons / electrons,
            "quantisation": float(np.sqrt(1 / 12)),
        }
        contrast = abs(simulate.contrast_levels)
        return f"{levels[effect]:.2g} levels of noise at a contrast of {contrast:.3g}"
    brightest = simulate.background_levels + max(simulate.contrast_levels, 0.0)
    return {
        "blur": f"blur of {simulate.blur_px:g} px on radii of {radius.min():.2g} to {radius.max():.2g} px",
        "vignetting": f"the light falls to {1 - simulate.vignetting:.2g} of that at the centre",
        "light_drift": f"{100 * simulate.light_drift:.2g} % more light than in the reference",
        "position_drift": f"drift of {simulate.position_drift_px:.2g} px, corrected",
        "saturation": f"contacts of {brightest:.3g} levels under a full scale of {2**simulate.bit_depth - 1}",
        "dust": f"{simulate.dust_count} grains among the contacts",
        "edge_roughness": f"edges deviate by {simulate.edge_roughness_px:.2g} px",
        "supersampling": f"blur of {simulate.blur_px:g} px, {simulate.supersampling} samples a pixel",
    }[effect]


def estimate_optics(scene: Scene, contacts: pd.DataFrame) -> tuple[EffectEstimate, ...]:
    """Measure what leaving out each effect of optics and sensor changes.

    The outputs are those that ``[tolerance]`` names: the sum of the areas, the sum of the forces (a^3/R; for
    the profile too), or the radii; with ``"all"`` each of the three. For a systematic effect the change is
    its mean, for noise the root mean square over realisations, including contacts that are lost.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame, contacts schema
        At one load: ``x_m, y_m, radius_m``, and ``force_N`` for the radii of curvature.

    Returns
    -------
    tuple of EffectEstimate
        One per effect of `OPTICS`; empty without the sections ``[simulate]`` and ``[camera]``.

    Raises
    ------
    InputError
        If the section ``[simulate]`` is not valid.
    """
    if scene.simulate is None or scene.camera is None:
        return ()
    shown = rendered_effects(scene) - {"position_drift"}
    camera = Camera.of(scene, contacts)
    if camera is not None and NO_FILM not in _film_reason(camera) and scene.effects.film != "off":
        shown |= {"film"}
    return tuple(_estimate(effect, scene, camera, shown) for effect in OPTICS)


def _estimate(effect: str, scene: Scene, camera: Camera | None, shown: Shown) -> EffectEstimate:
    simulate = scene.need("simulate", "the effects of optics and sensor")
    parameter = PARAMETER.get(effect)
    if effect in ("shot_noise", "read_noise") and simulate.electrons_per_level == 0:
        return EffectEstimate(effect, 0.0, "electrons_per_level is 0, so there is no noise")
    if parameter is not None and getattr(simulate, parameter) == 0:
        return EffectEstimate(effect, 0.0, f"{parameter} is 0")
    if camera is None:
        return EffectEstimate(effect, 0.0, "no contact lies in the frame")
    reason = _reason(effect, camera)
    camera.measure(shown)  # tells whether any pixel reaches full scale or zero
    if NO_FILM in reason or (effect == "saturation" and not camera.clipped):
        return EffectEstimate(effect, 0.0, reason)
    outputs = measured_outputs(scene.tolerance.output)
    changes = {name: camera.change(name, effect, shown) for name in outputs}
    return EffectEstimate(effect, max(changes.values()), reason, changes)
