"""The camera: from light to grey levels (noise, saturation, quantisation), and from them back to light.

Everything downstream assumes grey levels proportional to light. A camera with a gamma encoding gives::

    g / F = (light / light at full scale)^gamma

with the full scale F; other curves are given as a table. Linear levels are scaled such that full scale stays
full scale.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from contactimg.errors import FrameError
from contactimg.frame import Frame, full_scale_of_type
from contactimg.scene import Camera

Values = NDArray[np.float64]


def add_shot_noise(levels: Values, *, electrons_per_level: float, rng: np.random.Generator) -> Values:
    """Add shot noise: a grey level L gets the variance ``L / electrons_per_level``.

    Parameters
    ----------
    levels : ndarray, grey levels
        Not negative.
    electrons_per_level : float
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, grey levels

    Examples
    --------
    >>> add_shot_noise(np.full(3, 100.0), electrons_per_level=1e12, rng=np.random.default_rng(1)).round(3)
    array([100., 100., 100.])
    """
    return rng.poisson(levels * electrons_per_level) / electrons_per_level


def add_read_noise(levels: Values, *, std: float, rng: np.random.Generator) -> Values:
    """Add read noise, the same at all grey levels; ``std`` in grey levels."""
    return levels + rng.standard_normal(levels.shape) * std


def digitise(levels: Values, *, bit_depth: int, saturate: bool, quantise: bool, name: str) -> Frame:
    """Convert grey levels to the pixels of a frame.

    Parameters
    ----------
    levels : ndarray, shape (rows, columns), grey levels
    bit_depth : int
        Full scale is ``2^bit_depth - 1``.
    saturate : bool
        Limit the levels to 0 and full scale.
    quantise : bool
        Round them to whole numbers.
    name : str

    Returns
    -------
    Frame
        uint8 or uint16 if the levels are both rounded and limited, else float32.

    Examples
    --------
    >>> levels = np.array([[-3.0, 12.4, 700.0]])
    >>> digitise(levels, bit_depth=8, saturate=True, quantise=True, name="f").image
    array([[  0,  12, 255]], dtype=uint8)
    >>> digitise(levels, bit_depth=8, saturate=False, quantise=True, name="f").image
    array([[ -3.,  12., 700.]], dtype=float32)
    """
    full_scale = 2**bit_depth - 1
    if saturate:
        levels = np.clip(levels, 0, full_scale)
    if quantise:
        levels = np.rint(levels)
    whole = np.uint8 if bit_depth <= 8 else np.uint16
    dtype = whole if saturate and quantise else np.float32
    return Frame(levels.astype(dtype), name=name, full_scale=float(full_scale) if saturate else None)


def linear_light(levels: ArrayLike, camera: Camera, *, full_scale: float) -> Values:
    """Grey levels proportional to light, by the gamma or the table of a camera.

    Parameters
    ----------
    levels : array_like, grey levels
    camera : Camera
        Its table is interpolated by a monotone cubic and continued beyond its ends by straight lines.
    full_scale : float
        Grey level that stays as it is.

    Examples
    --------
    >>> linear_light([0.0, 127.5, 255.0], Camera(pixel_size_m=6e-6, gamma=0.5), full_scale=255.0)
    array([  0.  ,  63.75, 255.  ])
    """
    every = np.append(np.asarray(levels, float), full_scale)
    if camera.response is None:
        # read noise about a black background may be negative: odd continuation
        light = np.sign(every) * np.abs(every) ** (1.0 / camera.gamma)
    else:
        known, stated = np.array(camera.response).T
        curve, inside = PchipInterpolator(known, stated), np.clip(every, known[0], known[-1])
        slope = np.where(every < known[0], *(float(curve(known[k], 1)) for k in (0, -1)))
        light = curve(inside) + slope * (every - inside)
    return np.asarray(light[:-1] * (full_scale / light[-1])).reshape(np.shape(levels))


def linearise(frame: Frame, camera: Camera | None) -> Frame:
    """The frame with grey levels proportional to light.

    Parameters
    ----------
    frame : Frame
    camera : Camera or None

    Returns
    -------
    Frame
        float32 with the same full scale; the frame itself for a linear camera, or without one.

    Raises
    ------
    FrameError
        If the full scale is not known (images of floats), which fixes the zero of a power law.

    Examples
    --------
    >>> frame = Frame(np.array([[0, 51, 255]], np.uint8), full_scale=255)
    >>> linearise(frame, Camera(pixel_size_m=6e-6, gamma=0.5)).image
    array([[  0. ,  10.2, 255. ]], dtype=float32)
    """
    if camera is None or (camera.response is None and camera.gamma == 1.0):
        return frame
    full_scale = full_scale_of_type(frame.image) if frame.full_scale is None else frame.full_scale
    if full_scale is None:
        raise FrameError(
            f"{frame.name or 'frame'}: the response of the camera needs its full scale, which an image "
            "of floats does not state; give [camera] full_scale_levels"
        )
    if frame.image.dtype.kind != "u":
        light = linear_light(frame.image, camera, full_scale=full_scale).astype(np.float32)
        return replace(frame, image=light)
    every_level = np.arange(np.iinfo(frame.image.dtype).max + 1)
    curve = linear_light(every_level, camera, full_scale=full_scale).astype(np.float32)
    # pixels at full scale stay recognisable as such
    curve[every_level >= full_scale] = np.maximum(curve[every_level >= full_scale], full_scale)
    return replace(frame, image=curve[frame.image], full_scale=full_scale)
