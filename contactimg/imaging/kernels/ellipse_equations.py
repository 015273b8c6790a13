"""The image of a blurred ellipse, with its derivatives, and its normal equations (compiled).

An ellipse of half-axes a, b seen through a Gaussian of standard deviation s: with the coordinates X, Y along
its axes, g the Gaussian and Phi its integral,

    P(X, Y) = int b cos(f) g(b sin f - Y) [Phi((X + a cos f)/s) - Phi((X - a cos f)/s)] df.

The derivatives are integrals of the Gaussian along the outline: a parameter that moves the outline by v along
its normal n changes P by the integral of v.n g g. Both are summed over the same nodes, of which only those
near the pixel count. An ellipse has the same form along any chord; that along the normal of the rim is used,
so that a few nodes are enough.
"""

import math

import numpy as np
from scipy.special import ndtr

from contactimg.compiled import njit
from contactimg.imaging.kernels.normal_equations import LARGEST_TERM
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS, FIT_BLUR_WIDTHS

NODE_SPACING_BLUR_WIDTHS = 1.2
"""Of the nodes along the outline. Theory: the sum of a periodic function, here a Gaussian, converges as
``exp(-2 pi^2/h^2)``, 3e-9 for spacings of one width; sums of products like these err by less than 1e-5."""
FEWEST_NODES = 8
"""On half an outline. Accuracy."""
REGROUPED = {"contract", "reassoc", "arcp"}  # sums may be regrouped for speed; NaN and infinity stay

TABLE_END, TABLE_STEPS = 5.0, 64
"""Of the tables of the Gaussian and of its integral: where they end and steps for each blur width. Accuracy:
three terms of its series from the nearest node err by less than 1e-7."""
_AT = np.arange(int(-TABLE_END * TABLE_STEPS), int(TABLE_END * TABLE_STEPS) + 2) / TABLE_STEPS
BELL = np.stack([np.exp(-0.5 * _AT**2) / math.sqrt(2.0 * math.pi), ndtr(_AT)], axis=1)


@njit(cache=True, error_model="numpy", fastmath=REGROUPED, forceinline=True)
def blurred_ellipse(x, y, nx, ny, a, b, s, nodes, out):
    """Profile at a point of the ellipse's own axes into ``out``, with its derivatives.

    ``nx, ny``: unit vector about normal to the rim. ``nodes``: see `place_nodes`. ``out``: P,
    then by x and y of the centre, a, b, and the angle from the axis a towards b.
    """
    out[:] = 0.0
    # the ellipse as W n cos f + E sin f: chords along n, the point E furthest along the rim
    along = math.sqrt(a * a * ny * ny + b * b * nx * nx)
    wide_x, wide_y = a * b / along * nx, a * b / along * ny
    end_x, end_y = -a * a * ny / along, b * b * nx / along
    place, depth = nx * y - ny * x, nx * x + ny * y
    end, wide = nx * end_x + ny * end_y, a * b / along
    low = max((place - CLEAR_BLUR_WIDTHS * s) / along, -1.0)
    high = min((place + CLEAR_BLUR_WIDTHS * s) / along, 1.0)
    if not low < high:
        return
    count = nodes.shape[1]
    step = math.pi / count
    first = int((math.asin(low) + 0.5 * math.pi) / step)
    last = min(int((math.asin(high) + 0.5 * math.pi) / step) + 1, count)
    per_s = 1.0 / s
    cover = by_x = by_y = by_a = by_b = by_turn = 0.0
    for k in range(first, last):
        sine, cosine = nodes[0, k], nodes[1, k]
        beside = (along * sine - place) * per_s
        weight = _bell(beside)[0]
        near = (end * sine + wide * cosine - depth) * per_s
        far = (end * sine - wide * cosine - depth) * per_s
        near_light, near_cover = _bell(near)
        far_light, far_cover = _bell(far)
        cover += weight * cosine * (near_cover - far_cover)
        for side_light, turned in ((near_light, cosine), (far_light, -cosine)):
            if side_light > 0.0:
                light = weight * side_light
                qx, qy = wide_x * turned + end_x * sine, wide_y * turned + end_y * sine
                normal_x, normal_y = end_y * turned - wide_y * sine, wide_x * sine - end_x * turned
                by_x += light * normal_x
                by_y += light * normal_y
                by_a += light * normal_x * qx
                by_b += light * normal_y * qy
                by_turn += light * (qx * normal_y - qy * normal_x)
    weight = step * per_s
    out[0] = weight * along * cover
    weight *= per_s
    out[1], out[2], out[5] = weight * by_x, weight * by_y, weight * by_turn
    out[3], out[4] = weight * by_a / a, weight * by_b / b


@njit(cache=True, forceinline=True)
def _bell(position):
    """The normal density and its integral."""
    if not -CLEAR_BLUR_WIDTHS < position < CLEAR_BLUR_WIDTHS:
        return 0.0, 0.0 if position < 0.0 else 1.0
    at = int((position + TABLE_END) * TABLE_STEPS + 0.5)
    node = at * (1.0 / TABLE_STEPS) - TABLE_END
    off, density = position - node, BELL[at, 0]
    change = -off * (node + 0.5 * off)
    whole = BELL[at, 1] + density * off * (1.0 - off * (0.5 * node + off * (1.0 - node * node) / 6.0))
    return density * (1.0 + change * (1.0 + change * (0.5 + change / 6.0))), whole


@njit(cache=True)
def place_nodes(ellipse, s):
    """Sines and cosines of the nodes on half an outline."""
    spacing = NODE_SPACING_BLUR_WIDTHS * s
    count = max(int(math.pi * max(ellipse[0], ellipse[1]) / spacing) + 1, FEWEST_NODES)
    f = math.pi / count * (np.arange(count) + 0.5) - 0.5 * math.pi
    return np.stack((np.sin(f), np.cos(f)))


@njit(cache=True, error_model="numpy", fastmath=REGROUPED, forceinline=True)
def profile_at(dx, dy, ellipse, s, nodes, terms, out):
    """Profile at a point relative to the centre, with its derivatives by the parameters; how far off the rim.

    ``ellipse``: see `axes_of`; ``nodes``: see `place_nodes`. ``out``: derivatives of P by x, y, radius, the
    two components of the ellipticity, P itself, and the derivative by the blur. Returns the distance from the
    rim in blur widths, positive outside, to first order.
    """
    a, b, cosine, sine, eta = ellipse
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    q = math.sqrt((x / a) ** 2 + (y / b) ** 2)
    along_x, along_y = x / (a * a), y / (b * b)
    slope = math.sqrt(along_x * along_x + along_y * along_y)
    distance = (q - 1.0) * q / (slope * s) if slope > 0.0 else -b / s
    out[:] = 0.0
    if abs(distance) > 1.1 * CLEAR_BLUR_WIDTHS:
        out[5] = 1.0 if distance < 0.0 else 0.0
        return distance
    normal_x, normal_y = (along_x / slope, along_y / slope) if slope > 0.0 else (0.0, 1.0)
    blurred_ellipse(x, y, normal_x, normal_y, a, b, s, nodes, terms)
    by_x, by_y, by_a, by_b = terms[1], terms[2], a * terms[3], b * terms[4]
    out[0], out[1] = cosine * by_x - sine * by_y, sine * by_x + cosine * by_y
    out[2] = (by_a + by_b) / math.sqrt(a * b)
    # the angle turns as e turns by twice as much; at the circle the derivative has a limit
    stretch = by_a - by_b
    turn = 0.5 * terms[5] / eta
    double_cosine, double_sine = cosine * cosine - sine * sine, 2.0 * sine * cosine
    out[3] = double_cosine * stretch - double_sine * turn
    out[4] = double_sine * stretch + double_cosine * turn
    out[5] = terms[0]
    out[6] = (x * by_x + y * by_y - by_a - by_b) / s
    return distance


@njit(cache=True)
def axes_of(parameters):
    """Half-axes, cosine and sine of the angle, and ellipticity (at least 1e-4) of the parameters."""
    eta = max(math.hypot(parameters[3], parameters[4]), 1e-4)
    angle = 0.5 * math.atan2(parameters[4], parameters[3])
    stretch = math.exp(eta)
    return parameters[2] * stretch, parameters[2] / stretch, math.cos(angle), math.sin(angle), eta


@njit(cache=True, error_model="numpy")
def sample_ellipse(shape, parameters, s):
    """Profile of an ellipse at the pixels of a window, its derivatives, and how far off the rim they lie.

    Shape (rows, columns, 8): derivatives of P by x, y, radius and the two components of the ellipticity, P,
    its derivative by the blur, and the distance from the rim in blur widths, positive outside.
    """
    out, terms = np.empty((shape[0], shape[1], 8)), np.empty(6)
    ellipse = axes_of(parameters)
    nodes = place_nodes(ellipse, s)
    for j in range(shape[0]):
        for i in range(shape[1]):
            at = out[j, i]
            at[7] = profile_at(i - parameters[0], j - parameters[1], ellipse, s, nodes, terms, at)
    return out


@njit(cache=True, error_model="numpy")
def sum_over_ellipse(image, valid, parameters, s, variance, slope, normal, gradient):
    """Sums over the pixels of a window that holds one ellipse; outliers count linearly (Huber).

    ``variance (1 + slope m)`` is the variance of a pixel of model level m. ``normal``, shape (7, 7), gets the
    weighted products of the derivatives by the parameters (x, y, radius, ellipticity, contrast) and by the
    blur, ``gradient``, shape (6,), their products with the residuals. Returns chi-square; then sum of squared
    residuals over their variances and number of the pixels about the rim, and of those inside it.
    """
    at, terms = np.empty(7), np.empty(6)
    normal.fill(0.0)
    gradient.fill(0.0)
    loss = rim = rim_n = inside = inside_n = 0.0
    ellipse, light = axes_of(parameters), parameters[5]
    nodes = place_nodes(ellipse, s)
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            if valid.shape == image.shape and valid[j, i] == 0:
                continue
            distance = profile_at(i - parameters[0], j - parameters[1], ellipse, s, nodes, terms, at)
            # as bright as its own light makes a pixel, but no darker than the background
            level = light * at[5]
            residual, weight = image[j, i] - level, 1.0 / (variance * (1.0 + slope * max(level, 0.0)))
            square = residual * residual * weight
            share = min(SIGNIFICANT_SIGMA / math.sqrt(max(square, 1e-30)), 1.0)
            loss += square * share * (2.0 - share)
            if abs(distance) <= FIT_BLUR_WIDTHS:
                rim, rim_n = rim + min(square, LARGEST_TERM), rim_n + 1.0
            elif distance < 0.0:
                inside, inside_n = inside + min(square, LARGEST_TERM), inside_n + 1.0
            if at[5] == 0.0:
                continue
            for u in range(7):
                at[u] *= 1.0 if u == 5 else light
            for u in range(6):
                gradient[u] += at[u] * weight * share * residual
                for v in range(u, 7):
                    normal[u, v] += at[u] * weight * at[v]
    for u in range(6):
        for v in range(u):
            normal[u, v] = normal[v, u]
    return loss, (rim, rim_n), (inside, inside_n)
