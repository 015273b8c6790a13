"""The image of a blurred ellipse, and the normal equations of one ellipse (compiled).

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
from contactimg.imaging.kernels.normal_equations import LARGEST_TERM, OUTLIER_SIGMA, REACH_BLUR_WIDTHS

NODE_REACH_BLUR_WIDTHS = 4.2
"""Distance beyond which nodes and rims do not count. Theory: the integral of the Gaussian is 1.3e-5 there."""
NODE_SPACING_BLUR_WIDTHS = 1.2
"""Of the nodes along the outline. Theory: the sum of a periodic function, here a Gaussian, converges as
``exp(-2 pi^2/h^2)``, 3e-9 for spacings of one width; sums of products like these err by less than 1e-5."""
FEWEST_NODES = 8
"""On half an outline. Accuracy."""
LOSS_TOLERANCE = 0.03
"""Decrease of the loss that a step brings, or promises, for a fit to end with it. Accuracy: an error of 0.17
standard uncertainties, then one more quadratic step."""
PARAMETERS = 6
"""x, y, radius of the circle of equal area, two components of the ellipticity, contrast."""
BLUR = PARAMETERS
"""Row of the blur in the normal matrix."""
LIGHT_DAMPING = 0.1
"""Damping up to which a step is nearly that of Gauss and Newton. Accuracy: a tenth of the step."""
WIDEST_ELLIPTICITY = 1.2
"""Largest ``ln(a/b)/2``: ratio 11. Chosen: keeps a fit from needles."""

REGROUPED = {
    "contract",
    "reassoc",
    "arcp",
}  # sums may be regrouped for speed; NaN and infinity stay what they are

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
    low = max((place - NODE_REACH_BLUR_WIDTHS * s) / along, -1.0)
    high = min((place + NODE_REACH_BLUR_WIDTHS * s) / along, 1.0)
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
    if not -NODE_REACH_BLUR_WIDTHS < position < NODE_REACH_BLUR_WIDTHS:
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
    if abs(distance) > 1.1 * NODE_REACH_BLUR_WIDTHS:
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
def rim_distance(dx, dy, ellipse):
    """Distance from the centre of the circle of equal area at which a point of an ellipse has its like.

    As far off the rim, to first order; in the middle, where no distance from a rim is defined, at the same
    fraction of the half-axes. ``ellipse``: see `axes_of`.
    """
    a, b, cosine, sine, _ = ellipse
    x, y = (cosine * dx + sine * dy) / a, (cosine * dy - sine * dx) / b
    q, radius = math.sqrt(x * x + y * y), math.sqrt(a * b)
    slope = math.sqrt((x / a) ** 2 + (y / b) ** 2)
    if slope == 0.0:
        return 0.0
    off = (q - 1.0) * q / slope
    if q >= 1.0:
        return radius + off
    return q * q * (radius + off) + (1.0 - q * q) * q * radius


@njit(cache=True)
def draw_ellipse(image, parameters, s):
    """Add one blurred ellipse to an image."""
    terms, out = np.empty(6), np.empty(7)
    ellipse = axes_of(parameters)
    nodes = place_nodes(ellipse, s)
    rows, columns = image.shape
    reach = ellipse[0] + NODE_REACH_BLUR_WIDTHS * s
    for j in range(max(int(parameters[1] - reach), 0), min(int(parameters[1] + reach) + 2, rows)):
        for i in range(max(int(parameters[0] - reach), 0), min(int(parameters[0] + reach) + 2, columns)):
            profile_at(i - parameters[0], j - parameters[1], ellipse, s, nodes, terms, out)
            image[j, i] += parameters[5] * out[5]


@njit(cache=True, error_model="numpy")
def sum_ellipse(image, valid, parameters, s, noise, normal, gradient):
    """Normal matrix (with the blur as its last row), gradient and loss of one ellipse in a window.

    ``noise``: variance of a background pixel, and its relative growth per grey level. Residuals beyond
    `OUTLIER_SIGMA` count linearly (Huber). Returns the loss, the sum of squares about the rim and inside it,
    each with its number of pixels.
    """
    normal[:], gradient[:] = 0.0, 0.0
    terms, out = np.empty(6), np.empty(7)
    ellipse = axes_of(parameters)
    nodes = place_nodes(ellipse, s)
    contrast, masked = parameters[5], valid.shape == image.shape
    loss = rim = inside = 0.0
    n_rim = n_inside = 0
    rows, columns = image.shape
    for j in range(rows):
        for i in range(columns):
            if masked and valid[j, i] == 0:
                continue
            distance = profile_at(i - parameters[0], j - parameters[1], ellipse, s, nodes, terms, out)
            level = contrast * out[5]
            weight = 1.0 / (noise[0] * (1.0 + noise[1] * max(level, 0.0)))
            residual = image[j, i] - level
            square = residual * residual * weight
            share = min(OUTLIER_SIGMA / math.sqrt(max(square, 1e-30)), 1.0)
            loss += square * share * (2.0 - share)
            if abs(distance) <= REACH_BLUR_WIDTHS:
                rim += min(square, LARGEST_TERM)
                n_rim += 1
            elif distance < 0.0:
                inside += min(square, LARGEST_TERM)
                n_inside += 1
            if out[5] > 1e-6:
                for u in range(5):
                    out[u] *= contrast
                out[6] *= contrast
                for u in range(7):
                    gradient[u] += weight * share * residual * out[u]
                    for v in range(u, 7):
                        normal[u, v] += weight * out[u] * out[v]
    for u in range(7):
        for v in range(u):
            normal[u, v] = normal[v, u]
    return loss, rim, n_rim, inside, n_inside


@njit(cache=True)
def _move(before, step, s, contrast, after):
    """Parameters after a step, within limits, into ``after``."""
    after[:] = before + step
    limit = 0.5 * max(before[2], s)
    after[0] = before[0] + min(max(step[0], -limit), limit)
    after[1] = before[1] + min(max(step[1], -limit), limit)
    after[2] = min(max(after[2], 0.5 * before[2], 0.1 * s), 1.5 * before[2] + 0.5 * s)
    eta = math.hypot(after[3], after[4])
    if eta > WIDEST_ELLIPTICITY:
        after[3:5] *= WIDEST_ELLIPTICITY / eta
    after[5] = min(max(after[5], 0.3 * contrast), 3.0 * contrast)


@njit(cache=True, error_model="numpy")
def fit_one_ellipse(image, valid, start, s, noise, prior, round_, iterations):
    """Damped Gauss-Newton fit of one ellipse (of a disk, if ``round_``).

    ``prior``: mean and width of the contrast. Returns the parameters, the normal matrix with the prior of the
    contrast, the score of parameters and blur, the mean squares about the rim and inside (NaN without such
    pixels), the number of pixels about the rim, and the loss.
    """
    p, best = start.copy(), start.copy()
    normal, gradient = np.zeros((7, 7)), np.zeros(7)
    kept, damping, least = normal.copy(), 1e-3, np.inf
    step = np.zeros(PARAMETERS)
    sums = (0.0, 0.0, 0, 0.0, 0)
    right = gradient.copy()
    for _ in range(iterations):
        found = sum_ellipse(image, valid, p, s, noise, normal, gradient)
        loss = found[0] + ((p[5] - prior[0]) / prior[1]) ** 2
        if loss < least:
            small = least - loss < LOSS_TOLERANCE
            best[:], least, sums = p, loss, found
            normal[5, 5] += 1.0 / prior[1] ** 2
            gradient[5] += (prior[0] - p[5]) / prior[1] ** 2
            kept[:], right[:] = normal, gradient
            damping *= 0.1
            if small:
                break
        else:
            damping = max(10.0 * damping, 1e-3)
            if damping > 1e4:
                break
        matrix = kept[:PARAMETERS, :PARAMETERS].copy()
        for u in range(PARAMETERS):
            matrix[u, u] = matrix[u, u] * (1.0 + damping) + 1e-12
        if round_:
            matrix[3:5, :], matrix[:, 3:5] = 0.0, 0.0
            matrix[3, 3] = matrix[4, 4] = 1.0
        right_side = right[:PARAMETERS].copy()
        if round_:
            right_side[3:5] = 0.0
        step[:] = np.linalg.solve(matrix, right_side)
        _move(best, step, s, prior[0], p)
        # near its least value the loss follows its gradient no more: weights depend on the model
        if np.dot(step, right_side) < LOSS_TOLERANCE:
            if damping < LIGHT_DAMPING:
                best[:] = p
            break
    means = np.array([sums[1] / sums[2] if sums[2] else np.nan, sums[3] / sums[4] if sums[4] else np.nan])
    return best, kept, right, means, sums[2], least


@njit(cache=True)
def eliminate_parameters(p, normal, score, contrast, spread):
    """What a fitted ellipse says of ln contrast and blur.

    Returns the inverse of the normal matrix of its parameters, their response to ln contrast and blur, and
    score and information of these two with the parameters eliminated. ``normal`` and ``score`` are those of
    `fit_one_ellipse`; ``contrast`` and ``spread`` are its prior.
    """
    matrix = normal[:PARAMETERS, :PARAMETERS].copy()
    sizes = np.array([p[2], p[2], p[2], 1.0, 1.0, p[5]])  # a regularisation treats all parameters alike
    slight = 1e-9 * np.trace(matrix)
    for u in range(PARAMETERS):
        matrix[u, u] += slight / sizes[u] ** 2
    inverse, tight = np.linalg.inv(matrix), 1.0 / spread**2
    cross = np.zeros((PARAMETERS, 2))
    cross[5, 0] = -contrast * tight
    cross[:, 1] = normal[:PARAMETERS, BLUR]
    response = -inverse @ cross
    own = np.array([tight * contrast * (p[5] - contrast), score[BLUR]])
    information = np.array([[tight * contrast**2, 0.0], [0.0, normal[BLUR, BLUR]]])
    for u in range(PARAMETERS):
        for i in range(2):
            own[i] += response[u, i] * score[u]
            for j in range(2):
                information[i, j] += cross[u, i] * response[u, j]
    return inverse, response, own, information
