"""Speed of the contact models as ratios measured side by side, on one core.

python benchmarks/models_speed.py [solve] [pattern] [scaling] [plan] [boundary]

solve     coupled solve at a prescribed load against Cholesky factorisations of the same size
pattern   one member of the SA+ ensemble against plain NumPy (dense, outer root search on the indentation)
scaling   10^4 to 10^6 asperities: time, exponent, memory, for two families
plan      the plan of the effects against the solution with all of them, and against point forces
boundary  against boundary elements (ContactMechanics, if it is installed) on a patch
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import resource
import sys
import time
from functools import partial

import numpy as np
from scipy.linalg import cholesky
from scipy.optimize import brentq

from contactimg import generate_asperities, solve_interacting
from contactimg.effects.plan import make_plan
from contactimg.scene import scene_from_dict
from contactimg.surfaces import base_radius

LENS, MODULUS, LOADS = 0.1288, 4e6, (0.02, 0.2, 0.5)
MIDDLE = (5e-3, 5e-3)


def median_time(work, repeats=15):
    """Median seconds of processor time of repeated calls, the first not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times))


def solve():
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


def pattern():
    def ours(seed=1):
        table = generate_asperities("SA", side=1e-2, rng=np.random.default_rng(seed))
        where = {"indenter_radius": LENS, "contact_modulus": MODULUS, "apex": MIDDLE}
        for load in LOADS:
            for coupling in ("none", "asymptotic"):
                solve_interacting(table, load=load, coupling=coupling, **where)

    mine = median_time(ours, 15)
    plain = median_time(plain_pattern, 3)
    print(
        f"pattern: generate 1845 asperities, 3 loads, coupled and uncoupled: {1e3 * mine:.1f} ms, "
        f"plain NumPy {plain / mine:.1f} times as long"
    )


def plain_pattern(seed=1):
    """The same work as one would write it first: a loop of rejections, dense Newton with NumPy."""
    rng = np.random.default_rng(seed)
    height = np.sort(rng.uniform(30e-6, 60e-6, 1845))[::-1]
    disc = base_radius(height, np.full(1845, 1e-4))
    x, y = np.empty(1845), np.empty(1845)
    for i in range(1845):
        while True:
            x[i], y[i] = disc[i] + (1e-2 - 2 * disc[i]) * rng.random(2)
            if np.all((x[:i] - x[i]) ** 2 + (y[:i] - y[i]) ** 2 >= (disc[:i] + disc[i]) ** 2):
                break
    gap = height.max() - height + ((x - MIDDLE[0]) ** 2 + (y - MIDDLE[1]) ** 2) / (2 * LENS)
    gap -= gap.min()
    for load in LOADS:
        for coupled in (False, True):
            plain_solve(load, gap, x, y, coupled=coupled)


def plain_solve(load, gap, x, y, *, coupled):
    """Dense Newton on the contacts, the load as one more equation."""
    k = 4 / 3 * MODULUS * np.sqrt(1e-4)
    depth = brentq(lambda d: k * np.sum(np.maximum(d - gap, 0) ** 1.5) - load, 1e-9, 1e-3)
    if not coupled:
        return k * np.maximum(depth - gap, 0) ** 1.5
    rows = np.flatnonzero(gap < 2.2 * depth)
    r = np.hypot(x[rows, None] - x[rows], y[rows, None] - y[rows])
    np.fill_diagonal(r, np.inf)
    C, gap = 1 / (np.pi * MODULUS * r), gap[rows]
    delta = np.maximum(depth - gap, 0)
    for _ in range(60):
        touching = np.flatnonzero(delta > 0)
        inside = delta[touching]
        slope, force = 1.5 * k * np.sqrt(inside), k * inside**1.5
        jacobian = np.eye(touching.size) + C[np.ix_(touching, touching)] * slope
        border = -np.ones((touching.size, 1))
        system = np.block([[jacobian, border], [slope[None, :], np.zeros((1, 1))]])
        sag = C[:, touching] @ force
        error = np.r_[inside + sag[touching] - depth + gap[touching], force.sum() - load]
        change = np.linalg.solve(system, error)
        depth -= change[-1]
        delta = depth - gap - sag + C[:, touching] @ (slope * change[:-1])
        delta[touching] = inside - change[:-1]
        if np.abs(change).max() < 1e-12 * depth:
            break
    return k * np.maximum(delta, 0) ** 1.5


FAMILIES = {
    "the same rise of the lens over the pattern": 1.0,
    "the same fraction of the pattern in contact": 0.5,
}
"""Family of patterns of one mean pressure -> power of the area with which the radius of the lens grows."""


def scaling():
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


PARTS = {"solve": solve, "pattern": pattern, "scaling": scaling, "plan": plan, "boundary": boundary}

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
