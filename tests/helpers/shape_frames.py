"""Frames with contacts of any shape, supersampled eight times, made without anything of `contactimg`."""

import cv2
import numpy as np
from scipy.signal import fftconvolve
from skimage.draw import polygon

FINE = 8


def ellipse(ratio):
    """Outline of an ellipse of area pi."""
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    return [np.column_stack([np.sqrt(ratio) * np.cos(t), np.sin(t) / np.sqrt(ratio)])]


def ring(inner):
    """Outer and inner circle."""
    circle = ellipse(1.0)[0]
    return [circle, inner * circle]


def triangle():
    """An equilateral triangle."""
    t = 2 * np.pi / 3 * np.arange(3)
    return [np.column_stack([np.cos(t), np.sin(t)])]


def bone():
    """Two circles and a bar between them."""
    neck = np.arcsin(0.45)
    right, left = np.linspace(neck - np.pi, np.pi - neck, 200), np.linspace(neck, 2 * np.pi - neck, 200)
    ends = [
        np.column_stack([1.3 + np.cos(right), np.sin(right)]),
        np.column_stack([np.cos(left) - 1.3, np.sin(left)]),
    ]
    return [np.vstack(ends)]


def frame(shapes, places, *, angles, rng, shape=(150, 200), blur=1.4, noise=2.6, moffat=None):
    """Frame and reference of outlines at places (x, y, radius of equal area), and their true areas (px^2).

    ``moffat``: exponent of a Moffat point spread function of the same width at half height; None: Gaussian.
    """
    fine, areas = np.zeros((shape[0] * FINE, shape[1] * FINE), np.float32), []
    for outlines, (x, y, radius), angle in zip(shapes, places, angles, strict=True):
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        scale = radius * np.sqrt(np.pi / (_area(outlines[0]) - sum(_area(hole) for hole in outlines[1:])))
        count = 0
        for number, points in enumerate(outlines):
            column, row = ((scale * points @ turn + [x + 0.5, y + 0.5]) * FINE - 0.5).T
            inside = polygon(row, column, fine.shape)
            fine[inside] = 1.0 if number == 0 else 0.0
            count += len(inside[0]) if number == 0 else -len(inside[0])
        areas.append(count / FINE**2)
    if moffat is None:
        light = cv2.GaussianBlur(fine, (0, 0), blur * FINE, borderType=cv2.BORDER_REPLICATE)
    else:
        light = fftconvolve(fine, _moffat(2.355 * blur * FINE, moffat), mode="same")
    cover = light.reshape(shape[0], FINE, shape[1], FINE).mean(axis=(1, 3))
    exposed = [80.0 + 100.0 * part + rng.normal(0, noise, shape) for part in (cover, np.zeros(shape))]
    return *(np.clip(np.rint(part * 16), 0, 65535).astype(np.uint16) for part in exposed), np.array(areas)


def _area(points):
    x, y = points.T
    return abs(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _moffat(width, beta):
    y, x = np.mgrid[-120:121, -120:121]
    core = 0.5 * width / np.sqrt(2 ** (1 / beta) - 1)
    kernel = (1 + (x**2 + y**2) / core**2) ** -beta
    return (kernel / kernel.sum()).astype(np.float32)
