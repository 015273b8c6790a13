"""How small a contact is found, and how often something is found where nothing is."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pandas as pd
from imaging_bound import blurred_disk
from imaging_frames import Optics, render
from imaging_scores import markdown, number, put_table
from scipy import special

from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA
from contactimg.imaging.measure import measure_image

SHAPE = (600, 800)
CELL = 40  # px a contact
LARGE = 9.0  # px: every fifth contact of a frame, so that the frame shows its contrast
CONTRASTS = (5, 7, 10, 20, 40)  # over the noise of a pixel of the difference
RADII = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 1.7, 2.0, 2.4)  # px
NOISE = 2.0  # grey levels of frame and reference
OPTICS = Optics(shape=SHAPE, level=100.0, vignetting=0.0, dust=0, full_scale=65535.0)
TEXTURES = (0.02, 0.005)  # of the light: that of the other frames of the page, and a smooth surface
LEVELS = (3.5, 4.0, 4.5, 5.0, 5.5, 6.0)


def measure_completeness(seed, *, frames=1):
    """Share of small contacts found, by radius and contrast, at the first texture; both are in the table."""
    rows = []
    for texture, contrast in product(TEXTURES, CONTRASTS):
        for k, radius in enumerate(RADII):
            rng = np.random.default_rng([seed, contrast, k])
            hits = np.concatenate([_found(contrast, radius, texture, rng) for _ in range(frames)])
            share = hits.mean()
            # of Laplace's rule, so that a share of 0 or 1 has an error bar as well
            smooth = (hits.sum() + 1) / (len(hits) + 2)
            rows.append(
                {
                    "texture": texture,
                    "contrast": contrast,
                    "radius": radius,
                    "found": share,
                    "found_std": np.sqrt(smooth * (1 - smooth) / len(hits)),
                }
            )
    curves = pd.DataFrame(rows)
    put_table("completeness", _completeness_lines(curves))
    return curves[curves["texture"] == TEXTURES[0]]


def expected_share(contrast, radius):
    """Chance that the matched filter's peak at the centre of a disk exceeds the level of detection."""
    width = np.hypot(OPTICS.sigma, np.sqrt(1 / 12))
    # a Gaussian of the blur's width times the disk, and the noise behind it: one over 2 sqrt(pi) widths
    signal = float(blurred_disk(np.zeros(1), radius, np.hypot(width, OPTICS.sigma))[0])
    noise = 1 / (2 * np.sqrt(np.pi) * OPTICS.sigma)
    return float(special.ndtr(contrast * signal / noise - FALSE_ALARM_SIGMA))


def _found(contrast, radius, texture, rng):
    """Whether each small contact of a frame is among the measured ones."""
    levels = contrast * NOISE * np.sqrt(2)
    optics = replace(OPTICS, contrast=levels / OPTICS.level, texture=texture, camera=(1e4, 1e4 * NOISE))
    x, y = (
        axis.ravel().astype(float)
        for axis in np.meshgrid(*(np.arange(CELL, n - CELL + 1, CELL) for n in SHAPE[::-1]))
    )
    x, y = x + rng.uniform(-3, 3, x.size), y + rng.uniform(-3, 3, y.size)
    small = np.arange(x.size) % 5 > 0
    truth = pd.DataFrame({"x_px": x, "y_px": y, "radius_px": np.where(small, radius, LARGE)})
    frame, reference = render(truth, optics, rng)
    disks = measure_image(frame, reference, polarity="bright").disks
    near = np.hypot(disks.x_px.to_numpy() - x[small][:, None], disks.y_px.to_numpy() - y[small][:, None])
    return (near < 1.5).any(axis=1) if len(disks) else np.zeros(small.sum(), bool)


def _completeness_lines(curves):
    """Radius at which half and nine tenths are found."""
    rows = []
    for contrast, curve in curves.groupby("contrast"):
        radii = [
            _radius_of_share(curve[curve["texture"] == texture], share)
            for texture in TEXTURES
            for share in (0.5, 0.9)
        ]
        fine = np.geomspace(0.1, 4, 400)
        promised = [expected_share(contrast, a) for a in fine]
        rows.append([contrast, *radii, number(float(np.interp(0.5, promised, fine)))])
    return markdown(
        [
            "contrast / noise",
            "half are found at",
            "nine tenths at",
            "half, texture 0.5 %",
            "nine tenths, texture 0.5 %",
            "half by the filter alone",
        ],
        rows,
    )


def _radius_of_share(curve, share):
    """The radius at which a share is found."""
    rising = np.maximum.accumulate(curve.found)
    return number(float(np.interp(share, rising, curve.radius))) if rising.iloc[-1] >= share else "-"


def count_false_alarms(seed, *, frames=40):
    """Rows on frames without a contact, and peaks of their matched filter against normal noise."""
    optics = Optics()
    rows, with_rows, peaks = 0, 0, np.zeros(len(LEVELS))
    empty = pd.DataFrame({"x_px": [], "y_px": [], "radius_px": []})
    for k in range(frames):
        frame, reference = render(empty, optics, np.random.default_rng(seed + k))
        result = measure_image(frame, reference, polarity="bright", full_scale=255)
        rows, with_rows = rows + len(result.disks), with_rows + bool(len(result.disks))
        peaks += _peaks_above(result.difference, optics.sigma)
    lines = [["on frames", f"{count / frames:.3g}"] for count in peaks]
    promised = [_normal_peaks(level, optics) for level in LEVELS]
    table = [
        ["empty frames", *(line[1] for line in lines)],
        ["normal noise", *(f"{value:.2g}" for value in promised)],
    ]
    header = ["peaks a frame above", *(f"{level:g} std" for level in LEVELS)]
    put_table(
        "false alarms",
        [*markdown(header, table), "", f"{rows} rows on {with_rows} of {frames} frames without contact."],
    )


def _peaks_above(difference, width):
    """Local maxima of the filtered image above multiples of its noise, away from the border."""
    smooth = cv2.GaussianBlur(difference, (0, 0), width)[20:-20, 20:-20]
    noise = 1.4826 * np.median(np.abs(smooth - np.median(smooth)))
    top = smooth == cv2.dilate(smooth, np.ones((5, 5), np.uint8))
    heights = (smooth[top] - np.median(smooth)) / noise
    return np.array([np.count_nonzero(heights > level) for level in LEVELS])


def _normal_peaks(level, optics):
    """Mean number of maxima of a smooth normal field above a level.

    Adler, The Geometry of Random Fields (1981), theorem 6.3.1. The field is white
    noise behind a Gaussian of standard deviation s: the variance of its slope is 1/(2 s^2) of its own.
    """
    area = optics.shape[0] * optics.shape[1]
    return area / (2 * optics.sigma**2) * (2 * np.pi) ** -1.5 * level * np.exp(-(level**2) / 2)
