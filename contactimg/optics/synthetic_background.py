"""The background that all frames of a scene share: texture of the surface, dust, and vignetting.

Texture and dust move with the sample, vignetting does not. Texture and dust are drawn from the seed of the
scene, each from its own stream, so that they are the same in the reference and in every frame.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from contactimg.optics.psf import Psf
from contactimg.optics.spots import Spots, spots_image

Values = NDArray[np.float64]

TEXTURE_STREAM, DUST_STREAM = 1, 2
DUST_RADIUS_PX = (0.5, 3.0)  # log-uniform; chosen by hand
DUST_OPACITY = (0.2, 0.8)  # uniform; chosen by hand


def surface_texture(
    shape: tuple[int, int], *, rms: float, blur_px: float, shift_px: tuple[float, float], seed: int
) -> Values:
    """Relative brightness of a finely textured surface, blurred by the optics.

    Parameters
    ----------
    shape : (int, int)
    rms : float
        Standard deviation.
    blur_px : float, px
        Standard deviation of the Gaussian that blurs white noise; 0 leaves the pixels independent.
    shift_px : (float, float), px
        (x, y) by which the surface has moved, in any fraction of a pixel (by a phase in the spectrum).
    seed : int

    Returns
    -------
    ndarray, shape ``shape``
        Mean 0. The (slightly enlarged) field is periodic.

    Examples
    --------
    >>> texture = surface_texture((64, 80), rms=0.02, blur_px=1.4, shift_px=(0.0, 0.0), seed=1)
    >>> moved = surface_texture((64, 80), rms=0.02, blur_px=1.4, shift_px=(1.0, 0.0), seed=1)
    >>> bool(np.allclose(moved[:, 1:], texture[:, :-1]))
    True
    """
    size = tuple(fft.next_fast_len(n, real=True) for n in shape)
    spectrum, std, rows, columns = _texture_spectrum(size, blur_px, seed)
    phase = np.exp(-2j * np.pi * (columns * shift_px[0] + rows * shift_px[1]))
    # of a single pixel the spectrum is 0
    return (rms / (std or 1.0)) * fft.irfft2(spectrum * phase, s=size)[: shape[0], : shape[1]]


@lru_cache(maxsize=1)  # of the frames of a series, which follow each other
def _texture_spectrum(
    size: tuple[int, ...], blur_px: float, seed: int
) -> tuple[NDArray[np.complex128], float, Values, Values]:
    """Spectrum of the texture in its place, the standard deviation, and the frequencies per pixel.

    The frequencies are those of its rows and of its columns.
    """
    white = np.random.default_rng([seed, TEXTURE_STREAM]).standard_normal(size)
    rows, columns = fft.fftfreq(size[0])[:, None], fft.rfftfreq(size[1])
    gain = np.exp(-2 * np.pi**2 * blur_px**2 * (rows**2 + columns**2))
    gain[0, 0] = 0.0
    spectrum = fft.rfft2(white) * gain
    return spectrum, float(np.sqrt(np.mean(fft.irfft2(spectrum, s=size) ** 2))), rows, columns


def dust_shadow(
    shape: tuple[int, int], *, count: int, psf: Psf, shift_px: tuple[float, float], seed: int
) -> Values:
    """Fraction of the light that grains of dust absorb.

    Parameters
    ----------
    shape : (int, int)
    count : int
        Number of grains in the field.
    psf : Psf
    shift_px : (float, float), px
        (x, y) by which the surface has moved.
    seed : int

    Returns
    -------
    ndarray, shape ``shape``
        Between 0 and 1.
    """
    rng = np.random.default_rng([seed, DUST_STREAM])
    grains = Spots(
        x_px=rng.uniform(-0.5, shape[1] - 0.5, count) + shift_px[0],
        y_px=rng.uniform(-0.5, shape[0] - 0.5, count) + shift_px[1],
        radius_px=DUST_RADIUS_PX[0] * (DUST_RADIUS_PX[1] / DUST_RADIUS_PX[0]) ** rng.uniform(0, 1, count),
        brightness=rng.uniform(*DUST_OPACITY, count),
        outline_px=np.zeros((count, 1)),
    )
    return spots_image(grains, shape=shape, psf=psf)


def light_falloff(shape: tuple[int, int], *, fraction: float) -> Values:
    """Vignetting: relative light, 1 at the image centre, ``1 - fraction`` in the corners, quadratic between.

    Examples
    --------
    >>> light_falloff((3, 5), fraction=0.2)[[0, 1, 1], [0, 2, 0]]
    array([0.8 , 1.  , 0.84])
    """
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    square = y[:, None] ** 2 + x**2
    return 1 - fraction * square / max(square.max(), 1.0)
