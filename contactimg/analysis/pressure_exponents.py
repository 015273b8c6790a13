"""The exponent of a quantity against the local pressure, free of the errors that both have in common.

Number and load of an annulus fluctuate together, less than those of independent contacts, and by how much
depends on the surface: least squares with errors on both axes would need these covariances. The pressure of
the annuli beside an annulus is known without its own contacts. With that as the instrument the errors of an
annulus cancel on the average, whatever their covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import density_beside
from contactimg.analysis.estimates import Estimate, infinitesimal_covariance, student_estimate
from contactimg.analysis.power_laws import exponential
from contactimg.analysis.radial_profiles import MIN_PLACES_FOR_SCATTER
from contactimg.errors import InputError

Values = NDArray[np.float64]

_SUMS = ("area", "n", "n_forces", "a", "p")

WEIGHT_POWER = 2
"""Power of the expected number of contacts in the weight of an annulus. Theory: 1 has the least variance if
the law is a power law. Chosen: laws of Gaussian heights are curved, and with 1 the outermost annuli, far away
in ln p, decide by chance; with 2 the exponent of one place and that of 24 agree to 0.001 (RA-) and 0.009
(RA+) instead of 0.015 and 0.035, for 5 % more scatter."""

WEIGHT_STEP = 1e-4
"""Share of a block's weight by which the derivative by that weight is taken. Chosen: rounding and curvature
are both below 1e-3 of it."""


@dataclass(frozen=True)
class PressureExponent:
    """Exponent of a quantity against the pressure, and its amplitude at a reference pressure.

    Parameters
    ----------
    exponent, amplitude : Estimate
        Of one block without a scatter the standard deviations are NaN.
    n_blocks : int
        Places, or sectors of places, whose scatter gives the uncertainty.
    """

    exponent: Estimate
    amplitude: Estimate
    n_blocks: int


def fit_pressure_exponent(
    loads: Sequence[Mapping[str, pd.DataFrame]],
    quantity: str,
    *,
    reference: float,
    min_contacts: float = 5,
    confidence: float = 0.95,
) -> PressureExponent:
    """Fit the exponent of a quantity against the local pressure.

    Parameters
    ----------
    loads : sequence of mapping
        Per load: name of the place -> its table of `annulus_moments`, in sectors for fewer than four places.
    quantity : {"density", "mean_radius"}
    reference : float, Pa
        Where the amplitude is taken.
    min_contacts : float
        Fewest contacts, of all places together, that the annuli beside an annulus let expect in it.
    confidence : float
        Of the intervals.

    Raises
    ------
    InputError
        If fewer than two annuli are left, or their pressures do not follow those beside them.

    Notes
    -----
    ``m = sum w (z - <z>) y / sum w (z - <z>) x`` with ``x = ln p``, ``y`` the logarithm of the quantity,
    ``z`` that of the pressure beside (`contactimg.analysis.annuli.density_beside`) and ``w`` the square of
    the number of contacts that the annuli beside let expect. The uncertainty is that of the infinitesimal
    jackknife over places, or over sectors of fewer than four: all loads of a block change their weight
    together, as the same asperities touch.

    References
    ----------
    Durbin, Rev. Int. Stat. Inst. 22 (1954) 23, doi:10.2307/1401917, section 4: instrumental variables where
    both axes have errors.
    """
    blocks = _blocks(loads)
    tables = [_stacked(places, blocks) for places in loads]
    whole = [table.sum(axis=1, keepdims=True) for table in tables]
    kept = [_kept(table, min_contacts) for table in whole]
    value = _line(whole, kept, quantity, reference)[0]
    if len(blocks) < MIN_PLACES_FOR_SCATTER:
        std, freedom = np.array([np.nan, np.nan]), 0
    else:
        changed = [total - WEIGHT_STEP * table for total, table in zip(whole, tables, strict=True)]
        lines = _line(changed, kept, quantity, reference)
        covariance = infinitesimal_covariance((value - lines) / WEIGHT_STEP)
        std, freedom = np.sqrt(np.diag(covariance)), len(blocks) - 1
    offset, exponent = (
        student_estimate(float(v), float(s), freedom=freedom, confidence=confidence)
        for v, s in zip(value, std, strict=True)
    )
    return PressureExponent(exponent, exponential(offset), len(blocks))


def _blocks(loads: Sequence[Mapping[str, pd.DataFrame]]) -> list[tuple[str, int]]:
    """Places, or if some load has too few of them, sectors of places."""
    if min(len(places) for places in loads) >= MIN_PLACES_FOR_SCATTER:
        return sorted({(name, -1) for places in loads for name in places})
    return sorted(
        {
            (name, int(k))
            for places in loads
            for name, table in places.items()
            for k in (table["sector"].unique() if "sector" in table else [0])
        }
    )


def _stacked(places: Mapping[str, pd.DataFrame], blocks: Sequence[tuple[str, int]]) -> Values:
    """Sums over the annuli of one load, shape (sums, blocks, annuli)."""
    by_place = all(sector == -1 for _, sector in blocks)
    together = pd.concat(
        [
            table.assign(place=name, sector=-1 if by_place else table.get("sector", 0))
            for name, table in places.items()
        ],
        ignore_index=True,
    )
    annulus = together.groupby(["inner", "outer"], sort=True).ngroup().to_numpy()
    owner = pd.MultiIndex.from_frame(together[["place", "sector"]])
    block = pd.MultiIndex.from_tuples(blocks).get_indexer(owner)
    shape = len(blocks), int(annulus.max()) + 1
    cell = block * shape[1] + annulus
    flat = [np.bincount(cell, together[name].to_numpy(float), shape[0] * shape[1]) for name in _SUMS]
    return np.array([values.reshape(shape) for values in flat])


def _kept(sums: Values, min_contacts: float) -> NDArray[np.bool_]:
    """The annuli whose neighbours let expect enough contacts, shape (1, annuli)."""
    area, n, n_forces, _, p = sums
    enough = density_beside(n, area) * area >= min_contacts
    kept = enough & (n_forces > 0) & (p > 0) & (area > 0) & (density_beside(p, area) > 0)
    return np.asarray(kept, np.bool_)


def _line(
    sums: Sequence[Values], kept: Sequence[NDArray[np.bool_]], quantity: str, reference: float
) -> Values:
    """Logarithm of the amplitude, and exponent, of each row of sums; shape (rows, 2)."""
    columns = [_coordinates(table, k[0], quantity) for table, k in zip(sums, kept, strict=True)]
    x, y, z, w = np.concatenate(columns, axis=-1)
    w = w / w.sum(axis=-1, keepdims=True)
    x, z = x - np.log(reference), z - np.sum(w * z, axis=-1, keepdims=True)
    along = np.sum(w * z * x, axis=-1)
    if x.shape[-1] < 2 or not (along > 0).all():
        raise InputError(
            "an exponent against the pressure needs annuli of different pressure beside others with enough "
            f"contacts, got {x.shape[-1]} of them; allow fewer contacts or wider annuli"
        )
    exponent = np.sum(w * z * y, axis=-1) / along
    offset = np.sum(w * (y - exponent[:, None] * x), axis=-1)
    return np.column_stack([offset, exponent])


def _coordinates(sums: Values, kept: NDArray[np.bool_], quantity: str) -> Values:
    """Logarithms of pressure, quantity and pressure beside; weights; shape (4, rows, annuli)."""
    number, pressure = (density_beside(sums[_SUMS.index(name)], sums[0])[:, kept] for name in ("n", "p"))
    area, n, _, a, p = sums[:, :, kept]
    y = np.log(n / area) if quantity == "density" else np.log(a / n)
    return np.array([np.log(p / area), y, np.log(pressure), (number * area) ** WEIGHT_POWER])
