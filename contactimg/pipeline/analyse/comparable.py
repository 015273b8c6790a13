"""Whether runs that are analysed together can be places of one surface under one lens."""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from scipy.stats import ks_2samp

from contactimg.pipeline.analyse.places import Place

SAME_NUMBER = 0.01
"""Relative difference up to which two stated lengths or moduli are taken for the same. Chosen."""

CHANCE = 1e-4
"""Probability of asperities as different as these on one surface, below which they are taken for those of
another. Chosen: a false alarm in 200 analyses of twenty-four places."""


def differences(places: Sequence[Place]) -> Iterator[str]:
    """A sentence for each property in which a place differs from the first one."""
    if len(places) < 2:
        return
    first, *others = places
    for place in others:
        for name, one, two in _stated(first, place):
            if abs(two - one) > SAME_NUMBER * max(abs(one), abs(two)):
                yield (
                    f"{name} is {one:g} in {first.name} and {two:g} in {place.name}: they are averaged as "
                    f"places of one surface under one lens, with the value of {first.name}"
                )
        if first.asperities is None or place.asperities is None:
            continue
        for name, one, two in _statistics(first.asperities, place.asperities):
            if ks_2samp(one, two).pvalue < CHANCE:
                yield (
                    f"the asperities of {place.name} are not of the surface of {first.name}: {name} have "
                    f"means of {one.mean():.3g} and {two.mean():.3g} m and standard deviations of "
                    f"{one.std():.2g} and {two.std():.2g} m; analyse the runs apart"
                )


def _stated(first: Place, place: Place) -> Iterator[tuple[str, float, float]]:
    """Name and values of the numbers that both scenes state."""
    for section, names in (("indenter", ("radius_m",)), ("elastic", ("young_modulus_Pa", "thickness_m"))):
        one, two = (run.scene.source.get(section, {}) for run in (first, place))
        for name in names:
            if name in one and name in two:
                yield f"[{section}] {name}", float(one[name]), float(two[name])


def _statistics(first: pd.DataFrame, other: pd.DataFrame) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Heights about their median, and radii, of both tables; of heights only the scatter has a meaning."""
    heights = [table["height_m"] - table["height_m"].median() for table in (first, other)]
    yield "heights about their median", *(values.to_numpy(float) for values in heights)
    yield "radii", *(table["radius_m"].to_numpy(float) for table in (first, other))
