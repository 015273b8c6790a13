"""Pictures of frames with contacts drawn on them, as palette images: greys of the frame and a few colours.

OpenCV draws; a picture of two megapixels takes some hundredths of a second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import distribution
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from contactimg.tables.outlines import Outline

Indices = NDArray[np.uint8]

MEASURED, COUPLED, UNCOUPLED, HERTZ = "#56b4e9", "#d55e00", "#f0e442", "#ffffff"
"""Colours of measured contacts, of the two predictions, and of the Hertz circle: of the palette of Okabe and
Ito, chosen so that they differ in grey as well."""

QUANTILES, SAMPLE_SIDE = (0.005, 0.998), 500
"""Of the grey levels, shown black and white, and pixels along a side that they are taken from. Chosen: a
fraction of a second."""
GREYS = 64
"""Grey levels of a picture. Chosen: steps of 1.6 % are no coarser than the noise of most cameras, and the
file takes half the time and space that it takes with 256."""
LEAST_WIDTH_PX = 1600
"""Narrower frames are enlarged by a whole number."""
LINE_FRACTION = 1 / 800
"""Width of the lines over that of the picture. Chosen: 0.1 mm in a column of 85 mm."""
FONT_FRACTION = 1 / 40
"""Size of the font over the width of the picture. Chosen: 6 pt in a column of 85 mm."""
SHIFT_BITS = 4
"""Fractional bits of the positions that OpenCV takes: a sixteenth of a pixel."""
LARGEST_DRAWN_PX = 2.0**17
"""Positions and radii beyond are not drawn: larger than any picture. Chosen: OpenCV takes up to 2**27."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Outlines that are drawn alike.

    Parameters
    ----------
    outlines : sequence of Outline
    colour : str
        As ``#rrggbb``.
    label : str
        For the key below the picture; without one it is not in the key.
    dashes : (float, float), px of the picture
        Lengths of dash and gap; empty for a full line.
    gap_px : float
        Distance from the outline at which the line runs outside of it, px of the frame.
    width : float
        Of the line, times the usual one.
    square : bool
        Squares instead of outlines.
    """

    outlines: Sequence[Outline]
    colour: str
    label: str
    dashes: tuple[float, ...] = ()
    gap_px: float = 0.0
    width: float = 1.0
    square: bool = False


@dataclass(frozen=True, eq=False)
class Picture:
    """A palette image.

    Parameters
    ----------
    indices : ndarray of uint8, shape (rows, columns)
        Below `GREYS` grey levels, above colours.
    colours : tuple of str
        As ``#rrggbb``, from index `GREYS` on.
    """

    indices: Indices
    colours: tuple[str, ...]

    @property
    def palette(self) -> NDArray[np.uint8]:
        """Red, green and blue of each index, shape (k, 3)."""
        grey = np.rint(np.linspace(0, 255, GREYS))
        rgb = [[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in self.colours]
        return np.vstack([np.repeat(grey[:, None], 3, axis=1), np.reshape(rgb, (-1, 3))]).astype(np.uint8)


@dataclass(frozen=True)
class View:
    """The part of a frame that is shown, and how.

    Parameters
    ----------
    stretch : (float, float)
        Grey levels that are shown black and white.
    top, left : int
        Row and column of the first pixel, if the image is cropped from a larger one.
    title : str
        First line below the picture.
    pixel_size : float or None, m
        For the scale bar.
    zoom : int
        How often each pixel is repeated along a side; 0: until the picture is `LEAST_WIDTH_PX` wide.
    """

    stretch: tuple[float, float]
    top: int = 0
    left: int = 0
    title: str = ""
    pixel_size: float | None = None
    zoom: int = 0


@dataclass(frozen=True, eq=False)
class _Canvas:
    indices: Indices
    zoom: int
    origin: tuple[float, float]
    colours: dict[str, int] = field(default_factory=dict)

    def index(self, colour: str) -> int:
        """Palette index of a colour."""
        return self.colours.setdefault(colour, GREYS + len(self.colours))

    def place(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Positions in the frame as OpenCV takes those in the picture."""
        moved = (points - self.origin + 0.5) * self.zoom - 0.5
        return np.rint(moved * 2**SHIFT_BITS).astype(np.int32)

    @property
    def thickness(self) -> float:
        """Usual width of a line, px."""
        return LINE_FRACTION * self.indices.shape[1]


def draw_overlay(image: NDArray, layers: Sequence[Layer], view: View) -> Picture:
    """Draw contacts on a frame, with a key and a scale bar in a strip below it.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels; pixels without a value are black.
    layers : sequence of Layer
        The last on top.
    view : View

    Returns
    -------
    Picture
    """
    zoom = view.zoom or max(1, -(-LEAST_WIDTH_PX // image.shape[1]))
    grey = grey_indices(image, view.stretch)
    if zoom > 1:
        grey = grey.repeat(zoom, axis=0).repeat(zoom, axis=1)
    canvas = _Canvas(grey, zoom, (view.left, view.top))
    for layer in layers:
        _draw_layer(canvas, layer)
    strip = _strip(canvas, [layer for layer in layers if layer.label], view)
    return Picture(np.vstack([canvas.indices, strip]), tuple(canvas.colours))


def black_and_white(image: NDArray) -> list[float]:
    """Grey levels between which an image is shown, two; empty if no pixel has a value."""
    rows, columns = (max(1, size // SAMPLE_SIDE) for size in image.shape)
    sample = image[::rows, ::columns].astype(float)
    sample = sample[np.isfinite(sample)]
    return np.quantile(sample, QUANTILES).tolist() if sample.size else []


def crop_to(image: NDArray, x_px: NDArray, y_px: NDArray, *, margin_px: float) -> tuple[NDArray, int, int]:
    """Crop an image to the points and a margin; also return the first row and column.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    x_px, y_px : ndarray, shape (n,)
        Column and row of each point; without a point of finite coordinates the whole image is returned.
    margin_px : float
    """
    points = np.column_stack([y_px, x_px]).astype(float)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return image, 0, 0
    last = np.array(image.shape) - 1
    top, left = np.clip(points.min(axis=0) - margin_px, 0, last).astype(int).tolist()
    bottom, right = np.clip(points.max(axis=0) + margin_px, 0, last).astype(int).tolist()
    return image[top : bottom + 1, left : right + 1], top, left


def join_pictures(columns: Sequence[Sequence[Picture]]) -> Picture:
    """One picture of several: those of a column below each other, the columns side by side on black."""
    colours = list(dict.fromkeys(one for column in columns for picture in column for one in picture.colours))
    blocks = []
    for column in columns:
        width, parts = max(picture.indices.shape[1] for picture in column), []
        for picture in column:
            moved = [*range(GREYS), *(GREYS + colours.index(colour) for colour in picture.colours)]
            indices = np.array(moved, np.uint8)[picture.indices]
            parts.append(np.pad(indices, ((0, 0), (0, width - indices.shape[1]))))
        blocks.append(np.vstack(parts))
    height = max(len(block) for block in blocks)
    beside = [np.pad(block, ((0, height - len(block)), (0, 0))) for block in blocks]
    return Picture(np.hstack(beside), tuple(colours))


def grey_indices(image: NDArray, stretch: tuple[float, float]) -> Indices:
    """Grey levels as palette indices, 0 to ``GREYS - 1``."""
    if image.dtype.kind in "ub" and image.dtype.itemsize <= 2:  # each level is scaled once
        levels = np.arange(int(image.max(initial=0)) + 1, dtype=float)
        return grey_indices(levels, stretch)[image.astype(np.uint16, copy=False)]
    (low, high), levels = stretch, image
    scaled = (np.asarray(levels, np.float32) - np.float32(low)) * np.float32(GREYS / max(high - low, 1e-12))
    return np.clip(np.nan_to_num(scaled, nan=0.0, posinf=GREYS, neginf=0.0), 0, GREYS - 1).astype(np.uint8)


def _draw_layer(canvas: _Canvas, layer: Layer) -> None:
    index, thickness = canvas.index(layer.colour), max(1, round(layer.width * canvas.thickness))
    # the line lies wholly outside of the gap
    gap = layer.gap_px + (thickness / 2 / canvas.zoom if layer.gap_px else 0.0)
    for outline in layer.outlines:
        reach = np.array([outline.x, outline.y, outline.semi_major, outline.semi_minor]) * canvas.zoom
        if not np.abs(reach).max() <= LARGEST_DRAWN_PX:  # a table edited by hand may lack a number
            continue
        for line in _lines(outline, gap, canvas, square=layer.square):
            parts = [line]
            if layer.dashes:
                steps = np.hypot(*np.diff(line / 2**SHIFT_BITS, axis=0).T)
                along = np.concatenate([[0.0], np.cumsum(steps)])
                count = max(3, round(along[-1] / sum(layer.dashes)))  # a whole number of dashes
                period, share = max(along[-1], 1.0) / count, layer.dashes[0] / sum(layer.dashes)
                first = np.arange(count) * period
                ends = np.searchsorted(along, np.stack([first, first + share * period], axis=1))
                parts = [line[i : j + 1] for i, j in ends]
            cv2.polylines(
                canvas.indices, parts, isClosed=False, color=index, thickness=thickness, shift=SHIFT_BITS
            )


def _lines(outline: Outline, gap: float, canvas: _Canvas, *, square: bool) -> list[NDArray[np.int32]]:
    """Closed lines at a distance from the outline, with points about 2 px of the picture apart."""
    if outline.lines and not square:
        return _around(outline, gap, canvas)
    a, b = outline.semi_major + gap, outline.semi_minor + gap
    if square:
        x, y = a * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
    else:
        t = np.linspace(0, 2 * np.pi, max(12, int(np.pi * (a + b) * canvas.zoom / 2)) + 1)
        c, s = np.cos(outline.angle), np.sin(outline.angle)
        x, y = c * a * np.cos(t) - s * b * np.sin(t), s * a * np.cos(t) + c * b * np.sin(t)
    return [canvas.place(np.column_stack([outline.x + x, outline.y + y]))]


def _around(outline: Outline, gap: float, canvas: _Canvas) -> list[NDArray[np.int32]]:
    """Lines about a free shape at a distance, outside the rim and inside its holes."""
    lines = [canvas.place(line) for line in outline.lines]
    if not gap:
        return lines
    reach = max(1, round(gap * canvas.zoom))
    low = np.min([line.min(axis=0) for line in lines], axis=0) // 2**SHIFT_BITS - reach - 2
    high = np.max([line.max(axis=0) for line in lines], axis=0) // 2**SHIFT_BITS + reach + 3
    width, height = (high - low).tolist()
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [line - low * 2**SHIFT_BITS for line in lines], 1, shift=SHIFT_BITS)
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    found, _ = cv2.findContours(cv2.dilate(mask, disk), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    closed = [np.vstack([line, line[:1]])[:, 0] for line in found]
    return [((line + low) * 2**SHIFT_BITS).astype(np.int32) for line in closed]


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """The font that comes with matplotlib, found without the half second that its import takes."""
    fonts = distribution("matplotlib").locate_file("matplotlib/mpl-data/fonts/ttf")
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)


def _strip(canvas: _Canvas, layers: Sequence[Layer], view: View) -> Indices:
    """Title, key and scale bar below the picture, so that they hide nothing."""
    width = canvas.indices.shape[1]
    size = max(12, round(FONT_FRACTION * width))
    font, line = _font(size), round(1.5 * size)
    bar = None  # 1, 2 or 5 units long, at most a sixth of the picture
    if view.pixel_size is not None:
        target = width / canvas.zoom * view.pixel_size / 6
        decade = 10.0 ** np.floor(np.log10(target))
        length = max(step * decade for step in (1, 2, 5) if step * decade <= target)
        text = f"{length * 1e3:g} mm" if length >= 1e-3 else f"{length * 1e6:g} µm"
        bar = round(length / view.pixel_size * canvas.zoom), text
    bar_width = 0 if bar is None else max(bar[0], round(font.getlength(bar[1]))) + 2 * size
    places, x, row = [], size // 2, 1
    for layer in layers:
        long = round(font.getlength(layer.label)) + 3 * size
        if x + long > width - bar_width and x > size:
            x, row = size // 2, row + 1
        places.append((x, row))
        x += long
    strip = Image.new("L", (width, (max(row, 1) + 1) * line + size // 2))
    pen = ImageDraw.Draw(strip)
    titles = chain([view.title], (f"{view.title[:n]}…" for n in range(len(view.title) - 1, -1, -1)))
    title = next((one for one in titles if font.getlength(one) <= width - bar_width), "…")
    pen.text((size // 2, size // 4), title, GREYS - 1, font)
    for layer, (x, row) in zip(layers, places, strict=True):
        pen.text((x + 1.6 * size, row * line + size // 4), layer.label, GREYS - 1, font)
    if bar is not None:
        middle = width - bar_width / 2
        pen.text((middle, size // 4), bar[1], GREYS - 1, font, anchor="ma")
        top, half = 1.65 * line, bar[0] / 2
        pen.rectangle((middle - half, top, middle + half, top + size / 4), GREYS - 1)
    indices = np.array(strip)
    marks = _Canvas(indices, 1, (0, 0), canvas.colours)
    for layer, (x, row) in zip(layers, places, strict=True):
        disk = Outline(0, x + 0.8 * size, row * line + 0.85 * size, 0.5 * size, 0.5 * size)
        _draw_layer(marks, Layer([disk], layer.colour, "", layer.dashes, 0, layer.width, layer.square))
    return indices
