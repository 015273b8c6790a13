"""Asperities on a curved sample under a tilted indenter.

The surface of the sample below the asperities falls off from its summit, and the tilted indenter comes nearer
on one side. Both add a quadratic and a linear term to the gap, and to a parabolic cap: it remains one, with
its summit where the slopes agree. A sample of radius ``Rs`` with its summit below the apex of the lens acts
as a lens of radius ``1/(1/Rl + 1/Rs)``; a tilt ``theta`` acts as a shift of the apex by ``Rl theta``.
"""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError, ModelRangeError
from contactimg.scene import Scene
from contactimg.surfaces import BASE_COLUMN, MODULUS_COLUMN, check_asperities

Values = NDArray[np.float64]

MAX_CURVATURE_RATIO = 0.1
"""Largest curvature of the sample over that of an asperity. Theory: unequal curvatures of the sample make the
contacts elliptic; their load differs from that of circles with the mean curvature by less than 1e-4 there."""


def shaped_asperities(asperities: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """The asperities as the indenter meets them on the sample's shape; the table itself where none is stated.

    Parameters
    ----------
    asperities : DataFrame
        Columns of `contactimg.tables.ASPERITIES`.
    scene : Scene
        ``[sample]`` states the curvature, ``[indenter]`` the tilt, ``[elastic]`` the modulus that those of
        the asperities are compared with.

    Returns
    -------
    DataFrame
        Summits and radii of curvature, with a column for the height of the sample below each summit, and
        one for the contact modulus of each contact over that of the scene where moduli are given.

    Raises
    ------
    InputError
        If ellipsoidal caps stand on a curved sample or under a tilted indenter.
    ModelRangeError
        If the sample is so strongly curved that its contacts are not circles.

    Examples
    --------
    A tilt of 1 mrad shifts the summit of a cap of 0.1 mm by 0.1 um:

    >>> from contactimg.scene import scene_from_dict
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> scene = scene_from_dict({"indenter": {"radius_m": 0.1, "tilt_deg": 0.0572957795}})
    >>> round(float(shaped_asperities(cap, scene)["x_m"][0]) * 1e6, 6)
    0.1
    """
    sample, indenter = scene.sample, scene.indenter
    asperities = _with_modulus_ratios(asperities, scene)
    if not scene.shaped:
        return asperities
    table = check_asperities(asperities)
    if "radius_2_m" in table:
        raise InputError(
            "asperities: radius_2_m makes ellipsoidal caps, which stand on a flat under an upright lens "
            "only; leave out [sample], and tilt_deg in [indenter]"
        )
    curvature = (0.0, 0.0) if sample is None else sample.curvature
    summit = (0.0, 0.0) if sample is None else sample.summit
    slope = (0.0, 0.0) if indenter is None else indenter.slope
    apex = (0.0, 0.0) if indenter is None else indenter.apex
    cap = 1 / table["radius_m"].to_numpy()
    _check_curvature(curvature, cap)
    base, total = np.zeros(len(table)), []
    for axis, name in enumerate(("x_m", "y_m")):
        at = table[name].to_numpy()
        both = cap + curvature[axis]
        place = (cap * at + curvature[axis] * summit[axis] + slope[axis]) / both
        base += slope[axis] * (place - apex[axis]) - 0.5 * cap * (place - at) ** 2
        base -= 0.5 * curvature[axis] * (place - summit[axis]) ** 2
        table[name] = place
        total.append(both)
    table["radius_m"] = 1 / np.sqrt(total[0] * total[1])
    table[BASE_COLUMN] = base
    return table


def _with_modulus_ratios(asperities: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """The asperities with the contact modulus of each contact over that of the scene; as they are without.

    Soft asperities are part of the elastic body, and their modulus takes the place of its modulus. Asperities
    on the lens add their compliance to that of the elastic body. Poisson's ratio is that of the scene.
    """
    if scene.elastic is None or "young_modulus_Pa" not in asperities:
        return asperities
    own = check_asperities(asperities).get("young_modulus_Pa")
    table = asperities.drop(columns="young_modulus_Pa")
    if own is None:
        return table
    stiffness = own.to_numpy() / scene.elastic.young_modulus
    if scene.asperities is not None and scene.asperities.textured == "rigid":
        stiffness = 1 / (1 + 1 / stiffness)
    return table.assign(**{MODULUS_COLUMN: np.nan_to_num(stiffness, nan=1.0)})


def _check_curvature(curvature: tuple[float, float], cap: Values) -> None:
    """Refuse a sample whose curvature is not small against those of the asperities."""
    largest = max(abs(value) for value in curvature)
    if cap.size and largest > MAX_CURVATURE_RATIO * float(cap.min()):
        raise ModelRangeError(
            f"[sample] a radius of {1 / largest:.3g} m is less than {1 / MAX_CURVATURE_RATIO:g} times the "
            f"radius of an asperity, {1 / float(cap.min()):.3g} m; contacts would not be circles"
        )
