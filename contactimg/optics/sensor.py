"""The sensor: shot noise, read noise, saturation and quantisation of grey levels."""

import numpy as np
from numpy.typing import NDArray

from contactimg.frame import Frame

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


def add_read_noise(
    levels: Values, *, electrons: float, electrons_per_level: float, rng: np.random.Generator
) -> Values:
    """Add read noise of standard deviation ``electrons / electrons_per_level`` grey levels.

    Parameters
    ----------
    levels : ndarray, grey levels
    electrons, electrons_per_level : float
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, grey levels
    """
    return levels + rng.standard_normal(levels.shape) * (electrons / electrons_per_level)


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
