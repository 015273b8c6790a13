"""The Cramer-Rao bound of the radii of a frame's contacts: no unbiased estimator has a smaller variance.

Unknown are centre and radius of every contact and, shared by all, contrast, blur and background. Contacts
whose rims share pixels are coupled. Noise is that of the photons, of the read-out and of the rounding;
``references`` says how often the background was photographed as well (0: it is known exactly). Where contacts
differ in contrast by a relative ``spread``, each has one of its own, known to that spread beforehand.
"""

import numpy as np
from scipy import sparse, special

REACH = 6.0  # blur widths from the rim beyond which a disk's image does not depend on the radius


def radius_bounds(truth, optics, cameras, *, references=1, spread=0.0):
    """Smallest standard deviations of the radii in ``truth`` (x_px, y_px, radius_px), px."""
    rows, columns = optics.shape
    width = np.hypot(optics.sigma, np.sqrt(1 / 12))
    light = _Light(optics, cameras, references)
    entries, brightness = [], np.zeros(optics.shape)
    for i, (x, y, a) in enumerate(truth[["x_px", "y_px", "radius_px"]].to_numpy()):
        px, py, profile, slopes = _disk(x, y, a, width, optics.shape)
        brightness[py, px] += profile
        signal = optics.level * optics.contrast * light.vignetting(px, py)
        # x, y, radius; contrast (relative) and blur (px) follow those of all contacts, then the own contrasts
        columns_of = [3 * i, 3 * i + 1, 3 * i + 2, 3 * len(truth), 3 * len(truth) + 1]
        slopes = [*slopes[:3], profile, slopes[3]]
        if spread:
            columns_of, slopes = [*columns_of, 3 * len(truth) + 2 + i], [*slopes, profile]
        entries += [
            (py * columns + px, np.full(len(px), k), signal * slope)
            for k, slope in zip(columns_of, slopes, strict=True)
        ]
    pixel, parameter, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    n = (4 if spread else 3) * len(truth) + 3
    jacobian = sparse.coo_array((value, (pixel, parameter)), (rows * columns, n - 1)).tocsr()
    weight = 1.0 / light.variance(brightness).ravel()
    information = np.zeros((n, n))
    information[:-1, :-1] = (jacobian.T @ (sparse.diags_array(weight) @ jacobian)).toarray()
    information[-1, :-1] = information[:-1, -1] = jacobian.T @ weight
    information[-1, -1] = weight.sum()
    if spread:
        own = np.arange(3 * len(truth) + 2, n - 1)
        information[own, own] += 1.0 / spread**2
    return np.sqrt(np.diag(np.linalg.inv(information))[2 : 3 * len(truth) : 3])


def mean_radius_bound(radius, blur, noise, *, contrast, count):
    """Smallest standard deviation of the mean radius of alike contacts that stand alone, px.

    Contrast and blur are unknown and common to all ``count`` contacts, their radius too; ``blur`` in px
    without the pixel, ``noise`` of a pixel in grey levels, to which rounding adds.
    """
    width, side = np.hypot(blur, np.sqrt(1 / 12)), 2 * int(radius + REACH * np.hypot(blur, 1.0)) + 5
    _, _, profile, slopes = _disk(side // 2 + 0.3, side // 2 + 0.2, radius, width, (side, side))
    columns = [contrast * slopes[2], contrast * profile]
    if blur:
        columns.append(contrast * slopes[3])
    jacobian = np.stack(columns, axis=1)
    information = count * jacobian.T @ jacobian / (noise**2 + 1 / 12)
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


class _Light:
    """Mean light and its noise, grey levels."""

    def __init__(self, optics, cameras, references):
        self.optics, self.references = optics, references
        self.electrons, self.read = (
            cameras[optics.camera] if isinstance(optics.camera, str) else optics.camera
        )

    def vignetting(self, x, y):
        rows, columns = self.optics.shape
        u, v = (x - (columns - 1) / 2) / columns, (y - (rows - 1) / 2) / columns
        return 1 - self.optics.vignetting * (u**2 + v**2) / (0.25 + 0.25 * (rows / columns) ** 2)

    def variance(self, coverage):
        """Of each pixel of frame minus reference."""
        rows, columns = coverage.shape
        background = self.optics.level * self.vignetting(np.arange(columns), np.arange(rows)[:, None])
        fixed = (self.read / self.electrons) ** 2 + 1 / 12
        frame = background * (1 + self.optics.contrast * coverage) / self.electrons + fixed
        # the reference is scaled by the gain to the frame's light
        reference = self.optics.gain * background / self.electrons + self.optics.gain**2 * fixed
        return frame + self.references * reference


def _disk(x, y, a, s, shape):
    """Pixels of a blurred disk, its profile there, and the derivatives by x, y, radius and blur."""
    reach = a + REACH * s
    px, py = np.meshgrid(
        np.arange(max(int(x - reach), 0), min(int(x + reach) + 2, shape[1])),
        np.arange(max(int(y - reach), 0), min(int(y + reach) + 2, shape[0])),
    )
    r = np.hypot(px - x, py - y)
    near = r < reach
    px, py, r = px[near], py[near], np.maximum(r[near], 1e-9)
    gauss = a / s**2 * np.exp(-((r - a) ** 2) / (2 * s**2))
    by_radius, by_distance = gauss * special.i0e(r * a / s**2), -gauss * special.i1e(r * a / s**2)
    # P depends on r/s and a/s only
    by_width = -(a * by_radius + r * by_distance) / s
    by_blur = by_width * np.sqrt(max(s**2 - 1 / 12, 0)) / s
    slopes = [by_distance * (x - px) / r, by_distance * (y - py) / r, by_radius, by_blur]
    return px, py, blurred_disk(r, a, s), slopes


def blurred_disk(r, a, s):
    """Brightness at distance ``r`` of a unit disk of radius ``a`` behind a Gaussian of width ``s``."""
    profile = (r < a).astype(float)
    rim = np.abs(r - a) < REACH * s
    profile[rim] = special.chndtr((a / s) ** 2, 2, (r[rim] / s) ** 2)
    return profile
