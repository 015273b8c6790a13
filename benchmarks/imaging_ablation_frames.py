"""Frames on which the special cases of the imaging may matter: rendered ones with truth, and real ones."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from imaging_bound import radius_bounds
from imaging_crowds import place_contacts
from imaging_film import BANDWIDTH, INDEX, RUBBER, SPHERE, WAVELENGTH, shoot_film
from imaging_frames import CAMERAS, Optics, coverage, expose, match, render, scatter, surface_texture
from imaging_scores import ROOT, Shot

from contactimg.files import read_scene
from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.film_rim import FilmRim
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.optics.film import Light
from contactimg.pipeline.series import measure_series
from contactimg.scene import scene_from_dict
from contactimg.tradeoff.choice import measure_cheapest

SHAPE, CROWDED = (600, 800), (400, 600)
COUNT = 125  # contacts: as densely as 500 on 1600 x 1200 pixels
PLAIN = Optics(shape=SHAPE)
UNKNOWN = np.nan


@dataclass(frozen=True, eq=False)
class Condition:
    """Frames of one kind.

    Parameters
    ----------
    name : str
    shots : list of Shot
        Radii and bounds are NaN where the truth tells places alone, places where it tells their number alone.
    options : dict
        Of `contactimg.measure_image`.
    cases : tuple of str
        Cases that are switched off on it; empty: all.
    """

    name: str
    shots: list[Shot]
    options: dict[str, Any] = field(default_factory=dict)
    cases: tuple[str, ...] = ()

    def measure(self):
        """The measurement of each frame; of a series' with what the frames say together."""
        return [measure_image(shot.frame, shot.reference, **self.options) for shot in self.shots]


class Series(Condition):
    """Frames before one reference, measured together."""

    def measure(self):
        """Contacts and status of each frame."""
        with TemporaryDirectory() as folder:
            for k, shot in enumerate(self.shots):
                cv2.imwrite(f"{folder}/frame_{k}.png", shot.frame)
            cv2.imwrite(f"{folder}/reference.png", self.shots[0].reference)
            Path(folder, "scene.toml").write_text(SCENE, encoding="utf-8")
            run = measure_series(read_scene(Path(folder)), workers=1)
        parts = run.contacts.groupby("frame")
        return [
            SimpleNamespace(disks=parts.get_group(name), status=status)
            for name, status in zip(run.frames["frame"], run.frames["status"], strict=True)
        ]


class Tolerated(Condition):
    """Frames each measured by the cheaper method that meets a tolerance of the area."""

    def measure(self):
        """The measurement of each frame."""
        scene = scene_from_dict({"images": {"polarity": "bright"}, "tolerance": {"output": "area"}})
        return [
            measure_cheapest(shot.frame, shot.reference, scene=scene, relative=0.05, full_scale=255.0)[0]
            for shot in self.shots
        ]


SCENE = """[images]
reference = "reference.png"
frames = "frame_*.png"
polarity = "bright"
"""


def all_conditions(seed, frames, only, folder):
    """Rendered and real conditions, and series, whose names contain ``only``."""
    yield from rendered_conditions(seed, frames, only)
    for condition in (*real_conditions(folder), *series_conditions(seed)):
        if only in condition.name:
            yield condition


def rendered_conditions(seed, frames, only=""):
    """The rendered conditions whose names contain ``only``, one after the other."""
    for k, (name, (make, options)) in enumerate(RENDERED.items()):
        if only not in name:
            continue
        yield Condition(
            name,
            [make(np.random.default_rng([seed, k, n])) for n in range(frames)],
            {"polarity": "bright", "full_scale": 255.0} | options,
            ("film", "blurs") if "film" in options else (),
        )


def series_conditions(seed):
    """A series whose contacts are small on all frames but one, and frames measured to a tolerance."""
    rng = np.random.default_rng(seed)
    state = rng.bit_generator.state
    shots = []
    for count, radii in ((60, (1.5, 15.0)), (200, SMALL), (200, SMALL)):
        rng.bit_generator.state = state
        surface = surface_texture(PLAIN, rng)[16:-16, 16:-16]
        truth = scatter(count, PLAIN, rng, radii=radii)
        light = PLAIN.level * (1 + surface)
        images = (light * (1 + PLAIN.contrast * _cover(truth, PLAIN)), light)
        frame, reference = (expose(part, PLAIN, rng) for part in images)
        bounds = radius_bounds(truth, replace(PLAIN, vignetting=0.0), CAMERAS)
        shots.append(Shot(frame, reference, truth, bounds))
    yield Series("series of small contacts", shots, cases=("pooling",))
    rng = np.random.default_rng(seed)
    shots = [scattered(40, (15.0, 30.0))(rng), scattered()(rng)]
    yield Tolerated("area within 5 %", shots, cases=("choice",))


def shoot(optics, rng, truth, *, without_reference=False):
    """Frame, reference, truth and bounds."""
    frame, reference = render(truth, optics, rng)
    bounds = radius_bounds(truth, optics, CAMERAS)
    return Shot(frame, None if without_reference else reference, truth, bounds)


def scattered(count=COUNT, radii=(1.5, 30.0), *, without_reference=False, pairs=0.1, **options):
    """Maker of frames of contacts at random places."""
    optics = replace(PLAIN, **options)

    def make(rng):
        truth = scatter(count, optics, rng, radii=radii, pairs=pairs)
        return shoot(optics, rng, truth, without_reference=without_reference)

    return make


def lattice(pitch, radius, *, without_reference=False, **options):
    """Maker of frames full of contacts."""

    optics = replace(PLAIN, shape=CROWDED, **options)

    def make(rng):
        truth = place_contacts(pitch, radius, rng, shape=CROWDED)
        return shoot(optics, rng, truth, without_reference=without_reference)

    return make


def turned(degrees, shift, texture):
    """Maker of frames that are rotated and shifted against their reference."""
    optics = replace(PLAIN, texture=texture)

    def make(rng):
        truth = scatter(COUNT, optics, rng)
        margin = 60
        wide = replace(optics, shape=(SHAPE[0] + 2 * margin - 32, SHAPE[1] + 2 * margin - 32))
        surface = surface_texture(wide, rng)
        rows, columns = SHAPE
        matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), degrees, 1.0)
        matrix[:, 2] += shift
        # position in the frame -> position in the reference, which lies ``margin`` pixels inside the surface
        inverse = cv2.invertAffineTransform(matrix)
        inverse[:, 2] += margin
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(surface, inverse, (columns, rows), flags=flags)
        before = surface[margin:-margin, margin:-margin]
        cover = _cover(truth, optics)
        frame = optics.level * (1 + moved) * (1 + optics.contrast * cover)
        reference = optics.level / optics.gain * (1 + before)
        bounds = radius_bounds(truth, replace(optics, vignetting=0.0), CAMERAS)
        return Shot(expose(frame, optics, rng), expose(reference, optics, rng), truth, bounds)

    return make


def cluttered(rng):
    """Hairs, bars, bubbles and hot pixels among the contacts, away from them."""
    k, (rows, columns) = 4, SHAPE
    fine = np.zeros((rows * k, columns * k), np.float32)
    for width, height in ((2, 1.0), (3, 0.7), (6, 1.0)):
        points = np.cumsum(rng.normal(0, 14, (12, 2)), axis=0) + rng.uniform(150, 450, 2)
        cv2.polylines(fine, [np.int32(k * points)], isClosed=False, color=height, thickness=width * k)
    for _ in range(3):
        x, y = rng.uniform(60, 540, 2)
        cv2.circle(fine, (int(k * x), int(k * y)), 9 * k, 2.2, -1)
    clutter = cv2.GaussianBlur(fine, (0, 0), PLAIN.sigma * k).reshape(rows, k, columns, k).mean(axis=(1, 3))
    truth = scatter(COUNT, PLAIN, rng)
    distance = cv2.distanceTransform((clutter < 0.02).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    places = np.rint(truth[["y_px", "x_px"]].to_numpy()).astype(int)
    truth = truth[distance[tuple(places.T)] > truth.radius_px + 8].reset_index(drop=True)
    cover = np.maximum(_cover(truth, PLAIN), clutter)
    texture = surface_texture(PLAIN, rng)[16:-16, 16:-16]
    light = PLAIN.level * (1 + texture)
    frame, reference = (expose(part, PLAIN, rng) for part in (light * (1 + PLAIN.contrast * cover), light))
    for row, column in rng.integers(20, SHAPE[0] - 20, (6, 2)):
        if cover[row, column] < 0.01:
            frame[row, column] = 255
    return Shot(frame, reference, truth, radius_bounds(truth, replace(PLAIN, vignetting=0.0), CAMERAS))


def dust_that_moved(rng):
    """Specks of dust on the reference alone, contacts in the difference, and others on the frame alone."""
    shot = scattered()(rng)
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    images = []
    for image in (shot.frame, shot.reference):
        gain = np.ones(SHAPE)
        for cx, cy in rng.uniform(10, SHAPE[0] - 10, (15, 2)):
            size, depth = rng.uniform(1.5, 4.0), rng.uniform(0.3, 0.6)
            gain -= depth * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * size**2))
        images.append(np.clip(np.rint(image * np.maximum(gain, 0.2)), 0, 255).astype(np.uint8))
    return replace(shot, frame=images[0], reference=images[1])


GROUPS = [
    [(50, 60, 12), (66.4, 60, 6.5)],
    [(60, 50, 7), (53, 60.5, 6), (66.5, 60.5, 6.5)],
    [(60, 60, 3.8), (57.4, 65.2, 3.0), (54.0, 58.6, 3.4)],
    [(50, 50, 6), (63, 53, 8.5), (38.5, 53, 5.7), (48.5, 40.5, 4.5)],
    [(26, 70, 5.6), (36.3, 71, 5.2), (15.8, 71, 5.1), (48.5, 75.5, 9), (31, 78.3, 4.8)],
]
CELL = 80  # px


def overlapping(rng):
    """Groups of two to five contacts that touch or overlap, and single ones, one to a cell."""
    rows = []
    for top in range(0, SHAPE[0] - CELL + 1, CELL):
        for left in range(0, SHAPE[1] - CELL + 1, CELL):
            group = np.array(GROUPS[rng.integers(len(GROUPS))] if rng.random() < 0.6 else [(0, 0, 8.0)])
            angle, scale = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 1.4)
            place = (group[:, 0] + 1j * group[:, 1] - group[:, :2].mean(axis=0) @ [1, 1j]) * scale
            place = (
                place * np.exp(1j * angle) + (left + 1j * top + (CELL / 2) * (1 + 1j)) + rng.uniform(-3, 3)
            )
            kind = 2 if len(group) > 1 else 0
            rows += [(p.real, p.imag, scale * a, kind) for p, a in zip(place, group[:, 2], strict=True)]
    truth = pd.DataFrame(rows, columns=["x_px", "y_px", "radius_px", "kind"])
    return shoot(PLAIN, rng, truth)


def deformed(rng):
    """Contacts that are no disks: ellipses and lobes, each of which is one contact."""
    k, (rows, columns) = 4, SHAPE
    fine, places = np.zeros((rows * k, columns * k), np.float32), []
    for top in range(0, rows - CELL + 1, CELL):
        for left in range(0, columns - CELL + 1, CELL):
            cx, cy = left + CELL / 2 + rng.uniform(-5, 5), top + CELL / 2 + rng.uniform(-5, 5)
            angles, a = np.linspace(0, 2 * np.pi, 400), rng.uniform(8, 18)
            lobes = [0.0, 0.18, 0.05][rng.integers(3)] * np.cos(2 * angles + rng.uniform(0, 6))
            lobes += rng.uniform(0, 0.06) * np.cos(rng.integers(3, 6) * angles + rng.uniform(0, 6))
            rim = np.stack(
                [cx + a * (1 + lobes) * np.cos(angles), cy + a * (1 + lobes) * np.sin(angles)], axis=1
            )
            cv2.fillPoly(fine, [np.int32(k * rim)], 1.0)
            places.append((cx, cy, a, 0))
    cover = cv2.GaussianBlur(fine, (0, 0), PLAIN.sigma * k).reshape(rows, k, columns, k).mean(axis=(1, 3))
    light = PLAIN.level * (1 + surface_texture(PLAIN, rng)[16:-16, 16:-16])
    truth = pd.DataFrame(places, columns=["x_px", "y_px", "radius_px", "kind"])
    frame, reference = light * (1 + PLAIN.contrast * cover), light
    return Shot(expose(frame, PLAIN, rng), expose(reference, PLAIN, rng), truth, np.full(len(truth), UNKNOWN))


def soft_slopes(rng):
    """Wide soft contacts in noise, whose slopes cross the threshold in single pixels."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    soft = 14 / (1 + np.exp((np.hypot(x % 160 - 80, y % 120 - 60) - 25) / 4))
    frame, reference = (80 + part + rng.normal(0, 1.0, SHAPE) for part in (soft, 0.0))
    places = [(cx, cy, 25.0, 0) for cx in range(80, 800, 160) for cy in range(60, 600, 120)]
    truth = pd.DataFrame(places, columns=["x_px", "y_px", "radius_px", "kind"])
    return Shot(frame.astype(np.float32), reference.astype(np.float32), truth, np.full(len(truth), UNKNOWN))


def film(rng):
    """Contacts of spheres of 100 um with their air film, 6 um a pixel."""
    frame, reference, truth = shoot_film(6.0, rng)
    return Shot(frame, reference, truth.assign(kind=0), np.full(len(truth), UNKNOWN))


def _film_rim():
    light = Light(INDEX, RUBBER, 1e-6 * WAVELENGTH, 1e-6 * BANDWIDTH, (0.450e-6, 0.680e-6))
    return FilmRim(light, 1e-6 * SPHERE, 6e-6)


def _cover(truth, optics):
    return coverage(truth.x_px, truth.y_px, truth.radius_px, np.ones(len(truth)), optics)


SMALL = (0.8, 2.2)  # px: radii of contacts none of which shows its contrast
NO_TEXTURE = {"texture": 0.0, "dust": 0}
RENDERED: dict[str, tuple[Callable, dict]] = {
    "as assumed": (scattered(), {}),
    "contrast/noise 15": (scattered(camera="low"), {}),
    "contrast/noise 104": (scattered(camera="high"), {}),
    "contrast 14 levels, noise 2": (scattered(level=200.0, contrast=0.07, camera=(100.0, 141.0)), {}),
    "blur 4 px": (scattered(40, (5.0, 30.0), sigma=4.0), {}),
    "light scattered 20 %": (scattered(60, halo=0.2), {}),
    "light scattered 5 %": (scattered(halo=0.05), {}),
    "5 % brightness spread": (scattered(spread=0.05), {}),
    "soft edge of 1 px": (scattered(softness=1.0), {}),
    "light drift 10 %": (scattered(drift=0.1), {}),
    "no texture": (scattered(**NO_TEXTURE), {}),
    "texture 5 %": (scattered(texture=0.05), {}),
    "texture 5 %, contrast/noise 15": (scattered(texture=0.05, camera="low"), {}),
    "shifted by 20 px": (scattered(shift=(-15.6, 12.3)), {}),
    "turned by 0.4 degrees": (turned(0.4, (5.2, -3.1), 0.03), {}),
    "hairs, bubbles, hot pixels": (cluttered, {}),
    "dust that moved": (dust_that_moved, {}),
    "groups of 2-5": (overlapping, {}),
    "no disks": (deformed, {}),
    "small contacts": (scattered(200, SMALL), {}),
    "small contacts, contrast given": (
        scattered(200, SMALL),
        {"optics": SharedOptics(94.0, 2.0, 0.5, 1.4, 0.02)},
    ),
    "contrast given 40 % too small": (scattered(), {"optics": SharedOptics(60.0, 1.0, 0.5)}),
    "crowd, 28 % covered": (lattice(18.0, 5.0), {}),
    "crowd, 58 % covered": (lattice(25.0, 10.0), {}),
    "crowd, 82 % covered": (lattice(42.0, 20.0), {}),
    "crowd without reference": (
        lattice(42.0, 20.0, without_reference=True, vignetting=0.5, **NO_TEXTURE),
        {},
    ),
    "without reference": (scattered(without_reference=True, vignetting=0.3, **NO_TEXTURE), {}),
    "dark, without reference": (
        scattered(without_reference=True, contrast=-0.5, level=160.0, vignetting=0.3, **NO_TEXTURE),
        {"polarity": "auto"},
    ),
    "saturated": (scattered(level=150.0), {}),
    "air film": (film, {"film": _film_rim()}),
    "threshold": (scattered(pairs=0.3), {"method": "threshold"}),
    "threshold, groups of 2-5": (overlapping, {"method": "threshold"}),
    "threshold, hairs, bubbles, hot pixels": (cluttered, {"method": "threshold"}),
    "threshold, dust that moved": (dust_that_moved, {"method": "threshold"}),
    "threshold, soft slopes": (soft_slopes, {"method": "threshold"}),
    "threshold, contrast 14 levels, noise 2": (
        scattered(60, (6.0, 30.0), level=200.0, contrast=0.07, camera=(100.0, 141.0)),
        {"method": "threshold"},
    ),
    'threshold "auto"': (scattered(pairs=0.3), {"method": "threshold", "threshold": "auto"}),
}


def real_conditions(folder: Path | None):
    """The real images of the repository; from a folder given more, those whose contacts have been counted."""
    pins = ROOT / "sample_data" / "pins"
    frame, reference = (
        cv2.imread(str(pins / f"{name}.png")).mean(axis=2).astype(np.float32)
        for name in ("frame_1", "reference")
    )
    shots = [Shot(frame, reference, _counted(63), np.full(63, UNKNOWN))]
    yield Condition("pins (real)", shots, {"polarity": "auto"})
    yield Condition("threshold, pins (real)", shots, {"polarity": "auto", "method": "threshold"})
    beads = pd.read_csv(ROOT / "tests/data/beads_mono.csv")
    beads = beads[["x_px", "y_px"]].assign(radius_px=28.0, kind=0)
    image = cv2.imread(str(ROOT / "tests/data/beads_mono.png"), cv2.IMREAD_GRAYSCALE)
    yield Condition(
        "beads (real)", [Shot(image, None, beads, np.full(len(beads), UNKNOWN))], {"polarity": "bright"}
    )
    if folder is None:
        return
    for name, count in (("dot_pattern_02", 1339), ("dot_pattern_05", 4502)):
        image = cv2.imread(str(folder / "dots" / f"{name}.jpg"), cv2.IMREAD_GRAYSCALE)
        shot = Shot(image, None, _counted(count), np.full(count, UNKNOWN))
        yield Condition(f"{name} (real)", [shot], {"polarity": "dark"})


def _counted(count):
    """Truth of which the number alone is known."""
    return pd.DataFrame({"x_px": np.full(count, UNKNOWN), "y_px": UNKNOWN, "radius_px": UNKNOWN, "kind": 0})


def pair(truth, disks):
    """Index pairs of truth and disks; as many as there can be where the truth is a number alone."""
    if len(truth) and truth.x_px.isna().all():
        both = np.arange(min(len(truth), len(disks)))
        return np.stack([both, both], axis=1)
    return match(truth, disks)
