"""Frames of several places at nearly the same load, averaged together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import MOMENTS, SECTORS, annulus_edges, annulus_moments
from contactimg.analysis.area_against_load import group_loads
from contactimg.pipeline.analyse.places import Place
from contactimg.prediction import load_name
from contactimg.tables import Schema

Values = NDArray[np.float64]


@dataclass(frozen=True)
class LoadGroup:
    """Frames at one load.

    Parameters
    ----------
    name : str
        The frames' common name, or the load's.
    load : float, N
        Mean over the places.
    frames : dict
        Place -> its frames at this load.
    """

    name: str
    load: float
    frames: dict[str, list[str]]

    def frames_of(self, place: Place) -> list[str]:
        """The frames at this load that a place has."""
        present = set(place.frames["frame"])
        return [frame for frame in self.frames.get(place.name, []) if frame in present]

    def edges(self, places: Sequence[Place], *, width: float) -> Values:
        """Edges of the annuli (m) that hold the contacts of all places."""
        edges = [
            annulus_edges(_contacts(place, frame), centre=place.centre, width=width)
            for place in places
            for frame in self.frames_of(place)
        ]
        return max(edges, key=len)

    def moments(
        self, places: Sequence[Place], edges: Values, *, min_radius_px: float
    ) -> dict[str, pd.DataFrame]:
        """Place -> its sums over the annuli; several frames of a place count as one, averaged.

        Contacts smaller than ``min_radius_px`` do not count, measured or predicted.
        """
        return {
            place.name: _mean(
                [
                    annulus_moments(
                        _visible(place, frame, min_radius_px),
                        centre=place.centre,
                        edges=edges,
                        field=place.field(frame),
                        sectors=SECTORS,
                    )
                    for frame in self.frames_of(place)
                ]
            )
            for place in places
            if self.frames_of(place)
        }


def usable_frames(place: Place) -> pd.DataFrame:
    """Frames of a place with a load above zero and a measured area."""
    frames = place.frames
    return frames[(frames["load_N"] > 0) & frames["area_m2"].notna()]


def group_frames(places: Sequence[Place], *, tolerance: float) -> list[LoadGroup]:
    """Groups of nearly equal load, from the lowest.

    Parameters
    ----------
    places : sequence of Place
    tolerance : float
        Relative difference up to which loads are averaged as one.
    """
    shots = [
        (place.name, str(row["frame"]), float(row["load_N"]))
        for place in places
        for row in usable_frames(place).to_dict("records")
    ]
    numbers = group_loads([load for _, _, load in shots], tolerance=tolerance)
    return [
        _group([shot for shot, number in zip(shots, numbers, strict=True) if number == k])
        for k in range(int(numbers.max(initial=-1)) + 1)
    ]


def _group(shots: list[tuple[str, str, float]]) -> LoadGroup:
    """A group of (place, frame, load)."""
    frames: dict[str, list[str]] = {}
    for place, frame, _ in shots:
        frames.setdefault(place, []).append(frame)
    table = pd.DataFrame(shots, columns=["place", "frame", "load"])
    load = float(table.groupby("place")["load"].mean().mean())
    names = table["frame"].unique()
    return LoadGroup(str(names[0]) if len(names) == 1 else load_name(load), load, frames)


def _contacts(place: Place, frame: str) -> pd.DataFrame:
    """Contacts of one frame."""
    return place.contacts[place.contacts["frame"] == frame]


def _visible(place: Place, frame: str, min_radius_px: float) -> pd.DataFrame:
    """Contacts of one frame that the camera would resolve; all of them without a camera."""
    contacts = _contacts(place, frame)
    if place.pose is None:
        return contacts
    return contacts[contacts["radius_m"] >= min_radius_px * place.pose.pixel_size]


def _mean(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Mean of tables of moments over the same annuli."""
    columns = list(MOMENTS)
    mean = tables[0].copy()
    mean[columns] = sum(table[columns] for table in tables) / len(tables)
    return mean


def joined(tables: Sequence[pd.DataFrame], schema: Schema) -> pd.DataFrame:
    """Tables of one schema concatenated; empty tables are left out, so that they do not change dtypes."""
    return schema.conform(pd.concat([table for table in tables if len(table)] or [schema.empty()]))
