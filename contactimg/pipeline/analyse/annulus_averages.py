"""One load averaged over annuli and places: the measurement, and every model in the same way."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from contactimg.analysis.annuli import sum_moments
from contactimg.analysis.contacts_against_pressure import pressure_points
from contactimg.analysis.radial_profiles import (
    average_profile,
    hertz_profile,
    normalise_profile,
    ring_profile,
)
from contactimg.errors import ConvergenceError, InputError
from contactimg.pipeline.analyse.group_by_load import LoadGroup, joined
from contactimg.pipeline.analyse.places import Place
from contactimg.prediction import Prediction, asperity_density, predict_average
from contactimg.tables import NORMALISED, PRESSURE_LAW, PROFILE


@dataclass(frozen=True)
class SmoothContact:
    """A smooth sphere on the elastic body: radius (m) and contact modulus (Pa), for Hertz's law."""

    sphere_radius: float
    contact_modulus: float


@dataclass(frozen=True, eq=False)
class Surface:
    """Lens, elastic body and density of the asperities, which all places share.

    Parameters
    ----------
    place : Place
        The first place.
    density : float, 1/m^2
        Asperities per unit area, NaN if it is not known.
    """

    place: Place
    density: float

    @classmethod
    def of(cls, place: Place) -> "Surface":
        """The surface of a place."""
        section = place.scene.asperities
        try:
            density = np.nan if section is None else asperity_density(section, place.asperities)
        except InputError:
            density = np.nan
        return cls(place, density)

    @property
    def smooth(self) -> "SmoothContact | None":
        """The smooth contact under the same lens; None if the scene does not state lens and modulus."""
        scene = self.place.scene
        if scene.indenter is None or scene.elastic is None:
            return None
        return SmoothContact(scene.indenter.radius, scene.elastic.contact_modulus)


@dataclass(frozen=True, eq=False)
class LoadAverage:
    """Averages at one load.

    Parameters
    ----------
    group : LoadGroup
    moments : dict
        Model -> place -> sums over annuli, all with the same edges.
    profile, normalised : DataFrame
        Columns of `contactimg.tables.PROFILE` and `contactimg.tables.NORMALISED`.
    ring_area : float, m^2
        Of the Greenwood-Tripp model; NaN if it was not solved.
    """

    group: LoadGroup
    moments: dict[str, dict[str, pd.DataFrame]]
    profile: pd.DataFrame
    normalised: pd.DataFrame
    ring_area: float

    def points(self, surface: Surface, *, min_contacts: float) -> pd.DataFrame:
        """Density and mean radius against the local pressure, columns of `contactimg.tables.PRESSURE_LAW`."""
        parts = [PRESSURE_LAW.empty()]
        for model, places in self.moments.items():
            if model == "uncoupled" or not places:
                continue
            found = pressure_points(
                sum_moments(places.values()), min_contacts=min_contacts, by_those_beside=True
            )
            table = {
                "r_m": found["r"],
                "n_contacts": found["n"],
                "pressure_Pa": found["pressure"],
                "pressure_std_Pa": found["pressure_std"],
                "density_per_m2": found["density"],
                "density_std_per_m2": found["density_std"],
                "density_ratio": found["density"] / surface.density,
                "density_ratio_std": found["density_std"] / surface.density,
                "mean_radius_m": found["mean_radius"],
                "mean_radius_std_m": found["mean_radius_std"],
            }
            parts.append(
                PRESSURE_LAW.conform(
                    pd.DataFrame(table).assign(frame=self.group.name, model=model, load_N=self.group.load)
                )
            )
        return joined(parts, PRESSURE_LAW)


def average_load(
    group: LoadGroup,
    places_of: Mapping[str, list[Place]],
    surface: Surface,
    *,
    width: float,
    min_radius_px: float,
    notes: list[str],
) -> LoadAverage:
    """Average the contacts of one load over annuli.

    Parameters
    ----------
    group : LoadGroup
    places_of : mapping
        Model -> places with its contacts; one of `contactimg.tables.RUN_MODELS` is among them. With further
        models the averages of Greenwood-Tripp are added.
    surface : Surface
    width : float, m
        Of an annulus.
    min_radius_px : float
        Smallest contact that counts.
    notes : list of str
        Receives what could not be computed, and why.
    """
    edges = group.edges([place for places in places_of.values() for place in places], width=width)
    moments = {
        model: group.moments(places, edges, min_radius_px=min_radius_px)
        for model, places in places_of.items()
    }
    profiles = [
        average_profile(list(tables.values()), frame=group.name, model=model)
        for model, tables in moments.items()
        if tables
    ]
    ring_area, normalised = np.nan, NORMALISED.empty()
    if len(places_of) > 1:
        rings = _rings(group, surface, notes)
        if rings is not None:
            ring_area = float(rings.frames["area_m2"].iloc[0])
            profiles.append(ring_profile(rings.profile, edges, frame=group.name))
    smooth = surface.smooth
    if smooth is not None:
        hertz = hertz_profile(
            edges,
            load=group.load,
            frame=group.name,
            sphere_radius=smooth.sphere_radius,
            contact_modulus=smooth.contact_modulus,
        )
        profiles.append(hertz)
    profile = joined(profiles, PROFILE)
    if smooth is not None:
        normalised = normalise_profile(
            profile,
            load=group.load,
            sphere_radius=smooth.sphere_radius,
            contact_modulus=smooth.contact_modulus,
        )
    return LoadAverage(group, moments, profile, normalised, ring_area)


def _rings(group: LoadGroup, surface: Surface, notes: list[str]) -> Prediction | None:
    """The Greenwood-Tripp model at the load."""
    place = surface.place
    try:
        return predict_average(place.scene, place.asperities, load=group.load, model="gt")
    except (InputError, ConvergenceError) as error:
        notes.append(f"{group.name}: no Greenwood-Tripp curve: {error}")
        return None
