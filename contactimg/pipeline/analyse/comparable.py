"""Whether runs that are analysed together can be places of one surface under one lens."""

import logging
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from scipy.stats import ks_2samp

from contactimg.pipeline.analyse.places import Place

logger = logging.getLogger(__name__)

SAME_NUMBER = 0.01
"""Relative difference up to which two stated lengths or moduli are taken for the same. Chosen."""

CHANCE = 1e-4
"""Probability of asperities as different as these on one surface, below which they are taken for those of
another. Chosen: a false alarm in 200 analyses of twenty-four places."""

STATED = (("indenter", "radius_m"), ("elastic", "young_modulus_Pa"), ("elastic", "thickness_m"))


def warn_of_differences(places: Sequence[Place]) -> None:
    """Warn of places that do not belong together."""
    for difference in differences(places):
        logger.warning(difference)


def differences(places: Sequence[Place]) -> Iterator[str]:
    """A sentence for each property in which a place differs from the first one."""
    for place in places[1:]:
        yield from _different_numbers(places[0], place)
        yield from _different_asperities(places[0], place)


def _different_numbers(first: Place, place: Place) -> Iterator[str]:
    """Lens and rubber as the scenes state them."""
    for section, key in STATED:
        one, two = (float(run.scene.source.get(section, {}).get(key, np.nan)) for run in (first, place))
        if abs(two - one) > SAME_NUMBER * max(abs(one), abs(two)):
            yield (
                f"[{section}] {key} is {one:g} in {first.name} and {two:g} in {place.name}: averaged "
                f"as places of one surface under one lens, with the value of {first.name}"
            )


def _different_asperities(first: Place, place: Place) -> Iterator[str]:
    """Distributions of heights and radii; the height that heights count from has no meaning."""
    tables = [run.asperities for run in (first, place) if run.asperities is not None]
    if len(tables) < 2:
        return
    for column, name in (("height_m", "heights above their median"), ("radius_m", "radii")):
        one, two = (_centred(table[column]) for table in tables)
        if len(one) and len(two) and ks_2samp(one, two).pvalue < CHANCE:
            yield (
                f"the asperities of {place.name} are not of the surface of {first.name}: their {name} have "
                f"standard deviations of {np.std(one):.3g} and {np.std(two):.3g} m; analyse the runs apart"
            )


def _centred(column: pd.Series) -> np.ndarray:
    """Heights about their median; radii as they are, where they are known."""
    values = column.to_numpy(float)
    values = values[np.isfinite(values)]
    return values - np.median(values) if column.name == "height_m" and len(values) else values
