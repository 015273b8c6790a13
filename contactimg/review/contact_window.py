"""The pixels about one contact beside the model that the table states."""

import base64
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.fit.ellipse import render_ellipse
from contactimg.review.frame_light import FrameLight

MARGIN_BLUR_WIDTHS, MARGIN_RADII, LEAST_MARGIN_PX = 4.0, 0.8, 5.0
"""Of a window about its contact: the blurred edge ends there, and neighbours show."""
LARGEST_SIDE_PX = 512
"""Of a window; of a larger contact the middle is shown."""
UNIT = 1000
"""Of the numbers sent to the page: thousandths of the contrast."""
OVERSAMPLING = 4
"""Pixels each way in which the outline of a free shape is drawn before it is blurred. Accuracy: 1/8 px."""


def contact_window(
    light: FrameLight, contacts: pd.DataFrame, outlines: pd.DataFrame, label: int
) -> dict[str, Any]:
    """Pixels and model of the contact with a label.

    Parameters
    ----------
    light : FrameLight
    contacts, outlines : DataFrame
        Of the frame, as the page shows them.
    label : int
        Of a contact in the table.

    Returns
    -------
    dict
        left, top, columns, rows (px); pixels and model (base64 of int16, thousandths of the contrast);
        brightness of the contact over the contrast; noise over the contrast; blur (px).
    """
    row = contacts[contacts["label"] == label].iloc[0]
    left, top, right, bottom = _box(row, light.blur, light.image.shape)
    pixels = light.image[top:bottom, left:right]
    near = _near(contacts, (left, top, right, bottom), light.blur)
    own = _draw(near[near["label"] == label], outlines, light.blur, (left, top), pixels.shape)
    others = _draw(near[near["label"] != label], outlines, light.blur, (left, top), pixels.shape)
    model, brightness = _fit_brightness(pixels, own, others)
    return {
        "left": left,
        "top": top,
        "columns": right - left,
        "rows": bottom - top,
        "pixels": _packed(pixels),
        "model": _packed(model),
        "brightness": brightness,
        "noise": light.noise,
        "blur": light.blur,
    }


def _box(row: pd.Series, blur: float, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the window."""
    extent = float(np.nan_to_num(row["semi_major_px"], nan=row["radius_px"]))
    half = min(
        extent + max(MARGIN_BLUR_WIDTHS * blur, MARGIN_RADII * extent, LEAST_MARGIN_PX), LARGEST_SIDE_PX / 2
    )
    x, y = (float(np.clip(row[name], 0, size - 1)) for name, size in (("x_px", shape[1]), ("y_px", shape[0])))
    left, top = max(int(x - half), 0), max(int(y - half), 0)
    return left, top, min(int(x + half) + 2, shape[1]), min(int(y + half) + 2, shape[0])


def _near(contacts: pd.DataFrame, box: tuple[int, int, int, int], blur: float) -> pd.DataFrame:
    """Contacts whose blurred edge reaches into the window."""
    left, top, right, bottom = box
    reach = contacts["semi_major_px"].fillna(contacts["radius_px"]) + MARGIN_BLUR_WIDTHS * blur
    x, y = contacts["x_px"], contacts["y_px"]
    inside = (x > left - reach) & (x < right + reach) & (y > top - reach) & (y < bottom + reach)
    return contacts[inside]


def _draw(
    contacts: pd.DataFrame,
    outlines: pd.DataFrame,
    blur: float,
    corner: tuple[int, int],
    shape: tuple[int, ...],
) -> NDArray[np.float32]:
    """Contacts of brightness 1 in a window whose first pixel is at the corner (column, row)."""
    left, top = corner
    size = (shape[0], shape[1])
    disks = contacts[(contacts["shape"] == "disk") | contacts["semi_major_px"].isna()]
    places = disks[["x_px", "y_px", "radius_px"]].to_numpy(float) - (left, top, 0)
    image = render_disks(np.column_stack([places, np.ones(len(places))]), blur, size)
    for row in contacts[~contacts.index.isin(disks.index)].to_dict("records"):
        lines = outlines[outlines["label"] == row["label"]]
        if row["shape"] == "free" and len(lines):
            image += _draw_outlines(lines, blur, corner, size)
        else:
            image += render_ellipse(_ellipse(row, corner), blur, size)
    return image


def _ellipse(row: dict[Any, Any], corner: tuple[int, int]) -> NDArray[np.float64]:
    """Parameters of `render_ellipse`: x, y, radius, the two parts of the ellipticity, brightness."""
    major, minor = row["semi_major_px"], row["semi_minor_px"]
    log, angle = 0.5 * np.log(major / minor), np.nan_to_num(row["angle_rad"])
    x, y = row["x_px"] - corner[0], row["y_px"] - corner[1]
    parts = log * np.cos(2 * angle), log * np.sin(2 * angle)
    return np.array([x, y, np.sqrt(major * minor), *parts, 1.0])


def _draw_outlines(
    lines: pd.DataFrame, blur: float, corner: tuple[int, int], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """A free shape with its holes, blurred."""
    fine = np.zeros((shape[0] * OVERSAMPLING, shape[1] * OVERSAMPLING), np.uint8)
    corners = [
        np.rint((part[["x_px", "y_px"]].to_numpy(float) - corner + 0.5) * OVERSAMPLING - 0.5).astype(np.int32)
        for _, part in lines.groupby("outline")
    ]
    cv2.fillPoly(fine, corners, 255)
    image = cv2.resize(fine.astype(np.float32) / 255.0, shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(blur, 0.3)), np.float32)


def _fit_brightness(pixels: NDArray, own: NDArray, others: NDArray) -> tuple[NDArray[np.float32], float]:
    """The model with the brightness of the contact and that of its neighbours as the pixels show them."""
    parts = [part for part in (own, others) if part.any()]
    if not parts:
        return np.zeros_like(pixels), float("nan")
    design = np.stack([part.ravel() for part in parts], axis=1).astype(float)
    values, *_ = np.linalg.lstsq(design, pixels.ravel().astype(float), rcond=None)
    model = (design @ values).reshape(pixels.shape).astype(np.float32)
    return model, float(values[0]) if own.any() else float("nan")


def _packed(image: NDArray) -> str:
    """Base64 of thousandths as int16, little-endian."""
    top = np.iinfo(np.int16).max
    scaled = np.clip(np.nan_to_num(np.asarray(image, float) * UNIT), -top, top)
    return base64.b64encode(np.rint(scaled).astype("<i2").tobytes()).decode()
