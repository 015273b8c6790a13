"""Random problems for the contact models, from ordinary to absurd, and the verdict on each answer."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

import contactimg
from contactimg.errors import ContactimgError
from contactimg.models.greenwood_williamson import ring_weights
from contactimg.surfaces import UniformCaps

MODELS = ("interacting", "adhesive", "adhesive path", "gw", "gt", "ensemble", "pattern")

LARGEST_SIDE = 500.0
"""Side of the patterns of an ensemble in units of the size of a cap beyond which there is one of them: a
million caps take some ten seconds to be placed, and up to a minute to be solved."""

MAX_LOAD_ERROR = 1e-6
"""Largest relative difference between the sum of the forces and the load of a converged solution."""


@dataclass(frozen=True)
class Case:
    """One call of a model.

    Parameters
    ----------
    model : str
        One of `MODELS`.
    arguments : dict
        Keywords of the solver.
    table : DataFrame or None
        Asperities, for the models that take them.
    """

    model: str
    arguments: dict[str, Any]
    table: pd.DataFrame | None = field(default=None, repr=False)


def decades(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between ``10^low`` and ``10^high``, uniform in its logarithm."""
    return float(10 ** rng.uniform(low, high))


def draw_case(rng: np.random.Generator) -> Case:
    """One random case: a model, scales that are ordinary or spread over many decades, and a pattern."""
    model = str(rng.choice(MODELS, p=[0.35, 0.22, 0.1, 0.1, 0.13, 0.05, 0.05]))
    spread = float(rng.choice([0.3, 3.0, 9.0]))  # decades on either side of the ordinary scales
    if rng.random() < 0.1:
        spread = 60.0
    radius = 1e-4 * decades(rng, -spread, spread)
    modulus = 4e6 * decades(rng, -spread, spread) if rng.random() < 0.5 else 4e6
    lens = np.inf if rng.random() < 0.2 else 1e3 * radius * decades(rng, -spread / 3, spread / 3)
    load = float(modulus * radius**2 * decades(rng, -3 - spread, 0.5 + spread / 4))
    if rng.random() < 0.15:
        load = decades(rng, -18, 3)
    shared = {"indenter_radius": lens, "contact_modulus": modulus}
    if model in ("gw", "gt"):
        return Case(model, shared | draw_statistics(rng, radius, spread) | {"load": load})
    if model in ("ensemble", "pattern"):
        return draw_pattern(rng, model, shared, radius, load)
    table = draw_table(rng, radius, spread)
    shared["coupling"] = str(rng.choice(["none", "asymptotic", "full"]))
    shared["law"] = str(rng.choice(["hertz", "sphere"], p=[0.7, 0.3]))
    shared["apex"] = (float(table["x_m"].mean()), float(table["y_m"].mean()))
    if rng.random() < 0.25:
        shared["thickness"] = radius * decades(rng, -spread / 2, 2 + spread)
    depth = float((load / modulus / np.sqrt(radius)) ** (2 / 3))
    if model == "interacting":
        if rng.random() < 0.15:
            shared["coupling"] = "hertz"
        if rng.random() < 0.15:
            shared["method"] = str(rng.choice(["dense", "fast"]))
        prescribed = {"load": load} if rng.random() < 0.75 else {"indentation": depth}
        return Case(model, shared | prescribed, table)
    if shared["coupling"] == "full":
        shared["coupling"] = "asymptotic"
    shared["work_of_adhesion"] = (
        decades(rng, -9, 1)
        if rng.random() < 0.5
        else modulus * radius * decades(rng, -6 - spread / 2, -1 + spread / 4)
    )
    if model == "adhesive path":
        steps = load * rng.uniform(-0.2, 1.0, int(rng.integers(2, 5)))
        return Case(model, shared | {"loads": [load, *map(float, steps)]}, table)
    pull = float(rng.choice([1.0, 0.0, -1e-3, -1.0], p=[0.7, 0.1, 0.1, 0.1]))
    prescribed = {"load": pull * load} if rng.random() < 0.8 else {"indentation": pull * depth}
    return Case(model, shared | prescribed, table)


def draw_table(rng: np.random.Generator, radius: float, spread: float) -> pd.DataFrame:
    """A pattern of 1 to 300 asperities: random, crowded, in line, coincident; heights and radii as odd."""
    count = int(rng.choice([1, 2, 3, 10, 60, 300], p=[0.2, 0.2, 0.15, 0.2, 0.15, 0.1]))
    spacing = radius * float(rng.choice([3.0, 1.0, 30.0, decades(rng, -spread, spread)]))
    x, y = spacing * np.sqrt(count) * rng.uniform(size=(2, count))
    place = rng.random()
    if place < 0.1:
        y = np.zeros(count)
    elif place < 0.2 and count > 1:
        x[1], y[1] = x[0], y[0]
    elif place < 0.25:
        x, y = x + 1e6 * spacing, y - 1e6 * spacing
    radii = np.full(count, radius)
    if rng.random() < 0.4:
        radii = radius * 10 ** rng.uniform(-spread / 3, spread / 3, count)
    if rng.random() < 0.1:
        radii = radius * 10 ** rng.uniform(-6, 6, count)
    kind = rng.random()
    if kind < 0.2:
        height = np.full(count, 0.4 * radius)
    elif kind < 0.3:
        height = 0.4 * radius * (1 + 1e-15 * rng.integers(0, 4, count))
    elif kind < 0.4:
        height = 0.4 * radius * 10 ** rng.uniform(-spread, spread, count)
    elif kind < 0.5:
        height = np.where(np.arange(count) == 0, 10.0, 0.1) * radius
    else:
        height = radius * rng.uniform(0.3, 0.6, count)
    return pd.DataFrame({"x_m": x, "y_m": y, "height_m": height, "radius_m": radii})


def draw_statistics(rng: np.random.Generator, radius: float, spread: float) -> dict[str, Any]:
    """Height distribution, density and radius of a statistical model."""
    width = 0.3 * radius * decades(rng, -spread, spread / 3)
    mean = 0.5 * radius
    kind = rng.integers(3)
    heights: tuple[Any, ...] = (contactimg.UniformHeights, mean, mean + width)
    if kind == 1:
        heights = (contactimg.GaussianHeights, mean, width)
    elif kind == 2:
        heights = (contactimg.SampleHeights, mean + width * rng.uniform(size=int(rng.choice([1, 2, 50]))))
    density = float(0.2 / radius**2 * decades(rng, -spread, spread / 3))
    return {"heights": heights, "density": density, "radius": radius}


def draw_pattern(
    rng: np.random.Generator, model: str, shared: dict[str, Any], radius: float, load: float
) -> Case:
    """A generated pattern, or an ensemble of two."""
    kind: Any = str(rng.choice(["SA", "RA-", "RA+"]))
    size = 1e-4
    if rng.random() < 0.5:
        kind, size = (0.3 * radius, 0.6 * radius, radius), radius
    options = {"kind": kind, "side": size * decades(rng, -1, 1.5), "coverage": float(rng.uniform(0.01, 0.5))}
    if rng.random() < 0.15:
        options["side"] *= decades(rng, -6, 6)
    if model == "pattern":
        return Case(model, options | {"seed": int(rng.integers(1000))})
    patterns = 1 if options["side"] > LARGEST_SIDE * size else 2
    shared |= {"loads": [load], "patterns": patterns, "seed": int(rng.integers(1000))}
    return Case(model, options | shared)


def answers(case: Case) -> Iterable[tuple[float | None, Any]]:
    """Call the solver of a case: prescribed load (None if none) and solution, one by one."""
    a = case.arguments
    if case.model == "interacting":
        yield a.get("load"), contactimg.solve_interacting(case.table, **a)
    elif case.model == "adhesive":
        yield a.get("load"), contactimg.solve_adhesive(case.table, **a)
    elif case.model == "adhesive path":
        yield from zip(a["loads"], contactimg.solve_adhesive_path(case.table, **a), strict=True)
    elif case.model in ("gw", "gt"):
        law, *numbers = a["heights"]
        gw, gt = contactimg.solve_greenwood_williamson, contactimg.solve_greenwood_tripp
        yield a["load"], (gw if case.model == "gw" else gt)(**a | {"heights": law(*numbers)})
        return
    if case.model in ("ensemble", "pattern") and isinstance(a["kind"], tuple):
        a = a | {"kind": UniformCaps(*a["kind"])}
    if case.model == "ensemble":
        for member in contactimg.solve_ensemble(**a):
            yield from ((load, solution) for (_, load), solution in member.solutions.items())
    elif case.model == "pattern":
        options = {name: value for name, value in a.items() if name != "seed"}
        yield None, contactimg.generate_asperities(rng=np.random.default_rng(a["seed"]), **options)


def fault_of(load: float | None, solution: Any) -> str:
    """What is wrong with a solution that is said to be converged; empty if nothing is."""
    if isinstance(solution, pd.DataFrame):
        fine = len(solution) and np.isfinite(solution.to_numpy()).all()
        return "" if fine else "a pattern without finite asperities"
    if isinstance(solution, contactimg.InteractingSolution):
        numbers = [solution.force, solution.radius, solution.x, solution.y, solution.composite_radius]
        numbers += [[solution.indentation, solution.load, solution.area, solution.residual]]
        force_sum = float(np.sum(solution.force))
        if np.isnan(solution.penetration).any() or (solution.penetration == np.inf).any():
            return "penetrations are not finite"
        if np.any((solution.force != 0) & ~(solution.radius > 0)):
            return "a force without a contact radius"
    else:
        numbers = [solution.r, solution.pressure, solution.density, solution.depth, solution.area_fraction]
        numbers += [[solution.indentation, solution.load, solution.area, solution.residual]]
        force_sum = solution.load
        if solution.model == "gt":  # those of "gw" are a closed form, its rings a discretisation
            force_sum = float(ring_weights(solution.r) @ solution.pressure)
    if not all(np.isfinite(values).all() for values in numbers):
        return "numbers are not finite"
    if load and abs(force_sum / load - 1) > MAX_LOAD_ERROR:
        return f"the forces sum to {force_sum / load:.9g} of the load"
    return ""


def verdict(case: Case) -> tuple[str, str]:
    """Solve a case: ``converged``, ``stated`` (in the status), ``refused`` or ``FAULT``; and why."""
    outcome, why = "converged", ""
    try:
        for load, solution in answers(case):
            status = getattr(solution, "status", "converged")
            if status != "converged":
                outcome, why = "stated", status
            elif fault := fault_of(load, solution):
                return "FAULT", fault
    except ContactimgError as error:
        return "refused", f"{type(error).__name__}: {error}"
    except Exception as error:
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        place = (
            "" if frame is None else f"{frame.tb_frame.f_code.co_filename.split('/')[-1]}:{frame.tb_lineno}"
        )
        return "FAULT", f"{type(error).__name__} at {place}: {error}"
    return outcome, why
