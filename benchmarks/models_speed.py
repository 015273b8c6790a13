"""Speed of the contact models as ratios measured side by side, on one core.

python benchmarks/run.py models_speed.solve
"""

import resource
import time
from functools import partial

import numpy as np
from scipy.linalg import cholesky
from shared import times_by_turns

from contactimg import generate_asperities, solve_interacting
from contactimg.effects.plan import make_plan
from contactimg.scene import scene_from_dict

LENS, MODULUS = 0.1288, 4e6
MIDDLE = (5e-3, 5e-3)


def median_time(work, repeats=15):
    """Median seconds of processor time of repeated calls, the first not counted."""
    return float(np.median(times_by_turns([work], repeats)))


def solve():
    """A coupled solution at a prescribed load against Cholesky factorisations of the same size."""
    table = generate_asperities("SA", side=1e-2, rng=np.random.default_rng(0))
    where = {"indenter_radius": LENS, "contact_modulus": MODULUS, "load": 0.49, "apex": MIDDLE}
    seconds = {}
    for coupling in ("asymptotic", "full"):

        def run(coupling=coupling):
            return solve_interacting(table, coupling=coupling, **where)

        n = run().touching.size
        matrix = np.eye(n) * n + 1.0

        def factorise(matrix=matrix):
            return cholesky(matrix, lower=True, check_finite=False)

        ratio = np.median([median_time(run, 5) / median_time(factorise, 25) for _ in range(5)])
        seconds[coupling] = median_time(run, 9)
        print(f"solve: {coupling}, {n} contacts of {len(table)}: {ratio:.1f} Cholesky factorisations")
    print(f"solve: full takes {seconds['full'] / seconds['asymptotic']:.2f} times as long as asymptotic")


FAMILIES = {
    "the same rise of the lens over the pattern": 1.0,
    "the same fraction of the pattern in contact": 0.5,
}
"""Family of patterns of one mean pressure -> power of the area with which the radius of the lens grows."""


def scaling():
    """10^4 to 10^6 asperities: time, exponent, memory, for two families."""
    timed_solution(0.3)  # compiles
    for family, power in FAMILIES.items():
        print(f"scaling: {family}")
        scaling_of(power)


def scaling_of(power):
    """Time over size for one family."""
    previous = None
    for factor in (0.1, 1.0, 3.0, 10.0):
        asperities, solution, seconds = timed_solution(factor, power)
        now = np.array([seconds, asperities, solution.touching.size])
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        line = (
            f"scaling: {asperities} asperities, {solution.touching.size} contacts, "
            f"{solution.iterations} steps, residual {solution.residual:.1e}: {now[0]:.2f} s, "
            f"peak {memory:.2f} GiB"
        )
        if previous is not None:
            growth = np.log(now / previous)
            line += f", exponent {growth[0] / growth[1]:.2f} in asperities"
            line += f", {growth[0] / growth[2]:.2f} in contacts"
        print(line)
        previous = now


def timed_solution(factor, power=1.0):
    """Number of asperities, solution and processor time of a pattern whose area grows with ``factor``."""
    side, load, radius = 0.0736 * np.sqrt(factor), 4.5 * factor, 6.0 * factor**power
    table = generate_asperities("SA", side=side, rng=np.random.default_rng(0))
    start = time.thread_time()
    solution = solve_interacting(
        table, indenter_radius=radius, contact_modulus=MODULUS, load=load, apex=(side / 2, side / 2)
    )
    return len(table), solution, time.thread_time() - start


def plan():
    """The plan of the effects against the solution with all of them, and against point forces."""
    sample = generate_asperities("SA", side=1e-2, rng=np.random.default_rng(0))
    scenes = [(sample, LENS, MIDDLE, 0.49)]
    for factor in (0.1, 0.17, 0.45, 1.35):  # 553 to 10 000 contacts
        side = 0.0736 * np.sqrt(factor)
        table = generate_asperities("SA", side=side, rng=np.random.default_rng(0))
        scenes.append((table, 6.0 * factor, (side / 2, side / 2), 4.5 * factor))
    for table, radius, apex, load in scenes:
        where = {"indenter_radius": radius, "contact_modulus": MODULUS, "apex": apex, "load": load}
        scene = scene_from_dict(
            {
                "indenter": {"radius_m": radius, "apex_m": list(apex)},
                "elastic": {"young_modulus_Pa": 0.75 * MODULUS, "poisson_ratio": 0.5},
                "effects": {"model": "planned"},
            }
        )
        works = (
            partial(make_plan, scene, table, load=load),
            partial(solve_interacting, table, coupling="full", law="sphere", **where),
            partial(solve_interacting, table, **where),
        )
        repeats = 5 if len(table) < 30_000 else 1
        planned, everything, points = (median_time(work, repeats) for work in works)
        contacts = works[2]().touching.size
        print(
            f"plan: {len(table)} asperities, {contacts} contacts: {1e3 * planned:.1f} ms, "
            f"{planned / everything:.3f} of everything, {planned / points:.2f} of point forces"
        )


def boundary():
    """Against boundary elements (ContactMechanics, if it is installed) on a patch."""
    try:
        from ContactMechanics import FreeFFTElasticHalfSpace  # noqa: PLC0415 - optional
        from ContactMechanics.Systems import NonSmoothContactSystem  # noqa: PLC0415 - optional
        from SurfaceTopography import Topography  # noqa: PLC0415 - optional
    except ImportError:
        print("boundary: ContactMechanics is not installed (pip install ContactMechanics); skipped")
        return
    rng = np.random.default_rng(21)
    table = generate_asperities("SA", side=1e-3, coverage=0.35, rng=rng)
    table["radius_m"] *= rng.uniform(0.6, 1.4, len(table))  # unlike any stored truth: radii differ
    side, load = 1.2e-3, 0.02
    for points in (256, 512, 1024):
        h = side / points
        centre = h * (np.arange(points) + 0.5) - 0.1e-3
        X, Y = np.meshgrid(centre, centre, indexing="ij")
        surface = np.zeros((points, points))
        owner = np.full((points, points), -1)
        for k, cap in enumerate(table.itertuples()):
            bump = cap.height_m - ((X - cap.x_m) ** 2 + (Y - cap.y_m) ** 2) / (2 * cap.radius_m)
            higher = bump > surface
            surface[higher], owner[higher] = bump[higher], k
        half_space = FreeFFTElasticHalfSpace((points, points), MODULUS, (side, side))
        system = NonSmoothContactSystem(half_space, Topography(surface, physical_sizes=(side, side)))
        start = time.perf_counter()
        result = system.minimize_proxy(external_force=load, pentol=1e-12, maxiter=3000)
        seconds = time.perf_counter() - start
        pixel = np.asarray(system.substrate.force)[:points, :points]
        truth = np.bincount(owner[owner >= 0], pixel[owner >= 0], minlength=len(table))
        line = (
            f"boundary: {points} points a side, {seconds:.1f} s, {result.success}, sum {truth.sum():.6f} N;"
        )
        for coupling in ("none", "asymptotic", "full"):

            def run(coupling=coupling):
                return solve_interacting(
                    table, indenter_radius=np.inf, contact_modulus=MODULUS, load=load, coupling=coupling
                )

            error = np.abs(run().force - truth).sum() / load
            line += f" {coupling} {1e2 * error:.4f} %, {seconds / median_time(run, 3):.0f} times faster;"
        print(line)
