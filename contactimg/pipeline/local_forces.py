"""Local forces of a run where the rubber and the asperities' radii are known, and the sums over frames."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.forces import (
    ForceLaw,
    adhesive_pull,
    assign_forces,
    force_exponents,
    total_area,
    total_force,
)
from contactimg.scene import Scene
from contactimg.tables import FRAMES


def fill_forces(
    scene: Scene,
    contacts: pd.DataFrame,
    frames: pd.DataFrame,
    sites: pd.DataFrame | None,
    *,
    pixel_size: float,
    length_relative_std: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The contacts with their forces, and the frames with area and sum of the forces.

    Parameters
    ----------
    scene : Scene
        Its effect ``sphere_profile`` switched on means the sphere's exact law instead of Hertz's,
        ``adhesion`` contacts that adhere.
    contacts, frames : DataFrame
        The tables of a run; a frame without a number of contacts was not measured and gets no sums.
    sites : DataFrame or None
        Composite summits of the asperities.
    pixel_size : float, m
    length_relative_std : float
        Its relative standard uncertainty.

    Notes
    -----
    The uncertainties of the sums allow for one contact that is just too small to be seen.
    """
    relative, exponent = 0.0, np.full(len(contacts), 3.0)
    if scene.elastic is not None:
        law: ForceLaw = "sphere" if scene.effects.sphere_profile == "on" else "hertz"
        relative = scene.elastic.young_modulus_std / scene.elastic.young_modulus
        work = scene.elastic.work_of_adhesion if scene.effects.adhesion == "on" else 0.0
        modulus, radii = scene.elastic.contact_modulus, _sphere_radii(contacts, scene, sites)
        contacts = assign_forces(
            contacts,
            radii,
            contact_modulus=modulus,
            modulus_relative_std=relative,
            law=law,
            work_of_adhesion=work,
        )
        pulled = adhesive_pull(contacts["radius_m"], contact_modulus=modulus, work_of_adhesion=work)
        share = pulled / contacts["force_N"].to_numpy(float)
        exponent = force_exponents(contacts["radius_m"], radii, law=law) * (1 + share) - 1.5 * share
    groups = contacts.groupby("frame").indices
    rows = []
    for row in frames.to_dict("records"):
        if pd.notna(row["n_contacts"]):
            which = groups.get(row["frame"], np.empty(0, np.intp))
            part = contacts.iloc[which]
            # without a contact, an area of zero is worth no more than what would have been seen
            unseen = row["smallest_px"] * pixel_size if row["smallest_px"] > 0 or not len(part) else 0.0
            area = total_area(part, unseen_radius=unseen, length_relative_std=length_relative_std)
            row |= {"area_m2": area.value, "area_std_m2": area.std}
            if scene.elastic is not None:
                force = total_force(
                    part,
                    exponent=exponent[which],
                    unseen_radius=unseen,
                    modulus_relative_std=relative,
                    length_relative_std=length_relative_std,
                )
                row |= {"force_sum_N": force.value, "force_sum_std_N": force.std}
        rows.append(row)
    return contacts, FRAMES.conform(pd.DataFrame(rows, columns=list(FRAMES.columns)))


def _sphere_radii(contacts: pd.DataFrame, scene: Scene, sites: pd.DataFrame | None) -> NDArray[np.float64]:
    """Composite radius of each contact's asperity, or the one radius common to all, or NaN."""
    radii = np.full(len(contacts), common_radius(scene, sites))
    if sites is not None:
        matched = contacts["asperity"].notna().to_numpy()
        radii[matched] = sites["radius_m"].to_numpy(float)[contacts["asperity"][matched].to_numpy(int)]
    return radii


def common_radius(scene: Scene, sites: pd.DataFrame | None) -> float:
    """Composite radius that holds for contacts without an asperity of their own; NaN if radii differ."""
    if scene.asperities is not None and scene.asperities.radius is not None:
        curvature = 1 / scene.asperities.radius
        return 1 / (curvature + (1 / scene.indenter.radius if scene.indenter is not None else 0.0))
    radii = sites["radius_m"].to_numpy(float) if sites is not None else np.empty(0)
    return float(radii.mean()) if len(radii) and np.ptp(radii) <= 1e-6 * radii.max() else np.nan
