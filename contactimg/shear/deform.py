"""Contacts of a model under a tangential load, by measured laws: smaller along it, and displaced."""

import numpy as np
import pandas as pd

from contactimg.scene import Scene
from contactimg.shear.laws import EXPONENT


def shear_contacts(contacts: pd.DataFrame, scene: Scene, *, tangential: float) -> pd.DataFrame:
    """The contacts of a scene under a tangential load.

    Contact i carries ``q_i = Q A_i/sum A``. Its half-axis along the load shrinks by the factor ``1 - beta
    A_i^(-5/2) q_i^2``, so that its area is ``A_i - beta A_i^(-3/2) q_i^2``; the one across stays. All
    contacts move by the same distance along the load.

    Parameters
    ----------
    contacts : DataFrame, contacts schema
        All contacts that carry the load, disks in m.
    scene : Scene
        ``[simulate] shear_beta_m5_N2, shear_compliance_m_N`` and ``[load] tangential_direction_deg``.
    tangential : float, N
        ``Q``; its sign is the sense of the displacement.

    Returns
    -------
    DataFrame, contacts schema
        Ellipses with their angle on the sample; contacts whose area vanishes are left out.

    Notes
    -----
    For frames of known contacts, not a model of the mechanics: forces and indentations stay those without
    tangential load.
    """
    simulate, direction = scene.need("simulate", "shearing contacts"), scene.load.tangential_direction
    area = contacts["area_m2"].to_numpy(float)
    share = area / area.sum() if area.sum() > 0 else area
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 1 - simulate.shear_beta * area ** (EXPONENT - 1) * (tangential * share) ** 2
    stays = ratio > 0
    radius, ratio = contacts["radius_m"].to_numpy(float)[stays], ratio[stays]
    step = simulate.shear_compliance * tangential
    sheared = contacts.loc[stays].assign(
        x_m=contacts["x_m"][stays] + step * np.cos(direction),
        y_m=contacts["y_m"][stays] + step * np.sin(direction),
        radius_m=radius * np.sqrt(ratio),
        area_m2=area[stays] * ratio,
    )
    if not (ratio < 1).any():
        return sheared
    return sheared.assign(
        shape="ellipse",
        semi_major_m=radius,
        semi_minor_m=radius * ratio,
        angle_rad=(direction + np.pi) % np.pi - np.pi / 2,  # across the load, from -pi/2 to pi/2
    )
