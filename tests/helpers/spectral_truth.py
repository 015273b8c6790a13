"""Stored solutions of `spectral_contacts` and how to make them: caps under a lens, at a load."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from spectral_contacts import CapProblem, solve_caps

from contactimg import generate_asperities, solve_interacting
from contactimg.surfaces import composite_apexes

DATA = Path(__file__).parents[1] / "data"
ASPERITIES, CASES, CONTACTS = (
    DATA / f"models_spectral_{name}.csv" for name in ("asperities", "cases", "contacts")
)
MODULUS = 4e6
"""``E*``, Pa."""

UNIT = 1e-5
"""Length that the solutions are made in, m."""


@dataclass(frozen=True, eq=False)
class Case:
    """Asperities, lens and load, and the solution: indentation, forces, contact radii."""

    pattern: str
    law: str
    load: float
    lens: float
    apex: tuple[float, float]
    table: pd.DataFrame
    indentation: float = np.nan
    force: np.ndarray | None = None
    radius: np.ndarray | None = None

    def predict(self, coupling):
        """The contact model's answer."""
        where = {"indenter_radius": self.lens, "apex": self.apex, "contact_modulus": MODULUS}
        return solve_interacting(self.table, load=self.load, coupling=coupling, law=self.law, **where)


def patterns():
    """Name -> asperities, radius of the lens and position of its apex, m."""
    stored = pd.read_csv(DATA / "models_sa_plus.csv", usecols=["x_m", "y_m", "height_m", "radius_m"])
    made = {"SA+": (stored, 0.1288, (0.0, 0.0))}
    for name, seed, side in (("RA+", 77, 2e-3), ("RA-", 77, 2e-3), ("RA+ other", 2026112481, 2e-3)):
        table = generate_asperities(name[:3], side=side, rng=np.random.default_rng(seed))
        made[name] = (table, 0.013, (side / 2, side / 2))
    flat = generate_asperities("SA", side=1.5e-3, coverage=0.4, rng=np.random.default_rng(78))
    made["SA+ flat"] = (flat, np.inf, (0.0, 0.0))
    flat = generate_asperities("RA+", side=1e-3, rng=np.random.default_rng(79))
    made["RA+ flat"] = (flat, np.inf, (0.0, 0.0))
    return made


def cap_problem(case):
    """What to solve: composite paraboloids or spheres on a plane."""
    caps = composite_apexes(case.table, indenter_radius=case.lens, apex=case.apex)
    x, y, height, radius = (caps[c].to_numpy(float) / UNIT for c in ("x_m", "y_m", "height_m", "radius_m"))
    depth = height.max() - height

    def gap(row, px, py):
        squared = (px - x[row]) ** 2 + (py - y[row]) ** 2
        if case.law == "hertz":
            return depth[row] + squared / (2 * radius[row])
        return depth[row] + radius[row] - np.sqrt(radius[row] ** 2 - squared)

    guess = case.predict("full")
    load = case.load / MODULUS / UNIT**2
    problem = CapProblem(gap, x + 1j * y, load, guess.indentation / UNIT)
    return problem, guess.force / MODULUS / UNIT**2, guess.radius / UNIT


def solved(case, **options):
    """The case with its solution, and the solution's misfit."""
    answer = solve_caps(*cap_problem(case), **options)
    force, radius = answer.force * MODULUS * UNIT**2, np.sqrt(answer.area / np.pi) * UNIT
    place = (case.pattern, case.law, case.load, case.lens, case.apex, case.table)
    return Case(*place, answer.indentation * UNIT, force, radius), answer.misfit


def stored_cases():
    """All stored solutions."""
    asperities = dict(tuple(pd.read_csv(ASPERITIES).groupby("pattern")))
    contacts = dict(tuple(pd.read_csv(CONTACTS).groupby("case")))
    sa_plus = patterns()["SA+"][0]
    for row in pd.read_csv(CASES).itertuples():
        table = sa_plus if row.pattern == "SA+" else asperities[row.pattern].reset_index(drop=True)
        force, radius, found = np.zeros(len(table)), np.zeros(len(table)), contacts[row.case]
        force[found["asperity"]], radius[found["asperity"]] = found["force_N"], found["radius_m"]
        place = (row.pattern, row.law, row.load_N, row.lens_radius_m, (row.apex_x_m, row.apex_y_m), table)
        yield Case(*place, row.indentation_m, force, radius)
