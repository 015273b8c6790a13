"""Images that nobody made for contacts, and what must hold of their measurement all the same."""

from pathlib import Path

import cv2
import numpy as np
from hostile_frames import checkerboard, clouds, ramp, rings, stripes

from contactimg.imaging.measure import measure_image
from contactimg.imaging.reject.detections import CONTACT_COLUMNS
from contactimg.tables import Flag

METHODS, POLARITIES = ("disk", "threshold"), ("bright", "dark", "auto")
REFERENCES = ("none", "right", "wrong")
MOST_POOR = 0.2
"""Share of poor fits above which a frame must not be ok."""


def made_images(side: int) -> dict[str, np.ndarray]:
    """Noise, stripes, gradients, text and checkerboards."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[0:side, 0 : side + side // 3].astype(float)

    def levels(field):
        field = np.asarray(field, float)
        return np.clip(40 + 170 * field + rng.normal(0, 3, x.shape), 0, 255).astype(np.uint8)

    text = np.zeros(x.shape, np.uint8)
    for row in range(20, side, 24):
        cv2.putText(text, "contact 0.42 mN", (5, row), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1)
    patterns = {
        "noise": 0.5 + 0.15 * rng.standard_normal(x.shape),
        "salt": rng.random(x.shape) < 0.01,
        "clouds": clouds(x, y, rng),
        "stripes": stripes(x, y, rng),
        "checkerboard": checkerboard(x, y, rng),
        "gradient": ramp(x, y, rng),
        "rings": rings(x, y, rng),
        "text": text / 255,
        "scratches": np.abs(np.sin(x / 37) * 20 + y - side / 2) < 1,
    }
    return {name: levels(field) for name, field in patterns.items()}


def photographs() -> dict[str, np.ndarray]:
    """The images that scikit-image is installed with, as grey levels."""
    import skimage

    out = {}
    for path in sorted(Path(skimage.__file__).parent.joinpath("data").glob("*.*")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is not None and min(image.shape) >= 32:
            out[path.stem] = image
    return out


def reference_of(kind: str, image: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """None, the denoised image itself, or another image."""
    if kind == "none":
        return None
    if kind == "right":
        return cv2.medianBlur(image, 5)
    return cv2.resize(other, image.shape[::-1])


def stand_out(difference, disks, sign):
    """Mean inside each disk minus the median of a ring around it, in units of the ring's robust scatter."""
    out = np.full(len(disks), np.inf)
    y, x = np.mgrid[0 : difference.shape[0], 0 : difference.shape[1]]
    for k, (cx, cy, a) in enumerate(disks):
        box = tuple(
            slice(max(int(c - a - 12), 0), min(int(c + a + 13), size))
            for c, size in zip((cy, cx), difference.shape, strict=True)
        )
        r = np.hypot(x[box] - cx, y[box] - cy)
        inside, ring = difference[box][r <= max(a, 0.75)], difference[box][(r > a + 3) & (r < a + 10)]
        if inside.size and ring.size > 8:
            scatter = 1.4826 * np.median(np.abs(ring - np.median(ring)))
            out[k] = sign * (inside.mean() - np.median(ring)) / max(scatter, 1e-6)
    return out


def faults(image, reference, *, method, polarity, least_rise=0.0):
    """What is wrong with the measurement of an image: a list of sentences, empty if nothing."""
    result = measure_image(image, reference, method=method, polarity=polarity)
    disks, found = result.disks, []
    if abs(result.contrast) > 255:
        found.append(f"contrast {result.contrast:.4g} beyond the range")
    places = disks[["x_px", "y_px", "radius_px"]].to_numpy()
    if not np.isfinite(disks[list(CONTACT_COLUMNS)].to_numpy(float)).all():
        found.append("numbers that are not finite")
    rise = stand_out(result.difference, places, np.sign(result.contrast) or 1)
    if (rise <= least_rise).any():
        found.append(f"{np.count_nonzero(rise <= least_rise)} of {len(rise)} contacts do not stand out")
    poor = np.mean(disks["flags"].to_numpy() & int(Flag.POOR_FIT) > 0) if len(disks) else 0.0
    if poor > MOST_POOR and len(disks) >= 3 and result.status == "ok":
        found.append(f"ok although {poor:.0%} are poor fits")
    if result.status != "ok" and not result.message:
        found.append(f"status {result.status} without a sentence")
    return found
