"""How honest the analysis is: rendered frames against the model's own contacts, and coverage of intervals.

Closed loop: places of a surface are rendered, measured and analysed; the same analysis runs on the contacts
that were rendered. Differences of exponents, of p(r) and of laws against the local pressure are given over
the uncertainties that the analysis states. Coverage: how often 95 % intervals hold the truth, on simulated
contacts (no images) and simulated tables. Surfaces of one and of 24 places are drawn from a bank of patterns;
the truth is what the same number of places shows on average.

    python benchmarks/run.py analysis_closed_loop.frames --places 4
    python benchmarks/run.py analysis_closed_loop.contacts --repeats 100 --bank 240 --kinds SA+ RA-
    python benchmarks/run.py analysis_closed_loop.tables --repeats 1000
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import optimize, stats
from shared import pattern_scene

from contactimg.analysis.annuli import MOMENTS, SECTORS, annulus_moments, sum_moments
from contactimg.analysis.area_power_law import fit_area_law, frame_areas
from contactimg.analysis.contacts_against_pressure import fit_contact_law
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import fit_shear_stress
from contactimg.analysis.power_laws import BrokenLaw, PowerLaw, fit_broken_law
from contactimg.analysis.radial_profiles import average_profile
from contactimg.analysis.topography import describe_topography
from contactimg.cli import main as contactimg
from contactimg.models.interacting import solve_loads
from contactimg.pipeline.analyse.analysis import Analysis, AnalysisOptions, analyse_places
from contactimg.pipeline.analyse.places import open_place
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.surfaces import generate_asperities

Values = NDArray[np.float64]

LOADS_N = [0.02, 0.05, 0.1, 0.2, 0.35, 0.5]
SIDE = 0.01
SURFACES = {"SA+": 0.4, "SA-": 0.1}
KINDS = {"SA+": ("SA", 0.4), "SA-": ("SA", 0.1), "RA+": ("RA+", None), "RA-": ("RA-", None)}
LAWS = {"eta(p)": "density", "mean radius": "mean_radius"}
RADIUS_STD = 0.3e-6
"""Standard deviation of a measured radius, m: 0.05 pixels of 6 um."""


def measured_places(folder: Path, coverage: float, count: int, seed: int) -> list[str]:
    """Render and measure places of a surface; their runs."""
    runs = []
    for number in range(count):
        scene = pattern_scene(seed + number, side=SIDE, coverage=coverage, loads_N=LOADS_N)
        frames, run = folder / f"frames_{number}", folder / f"run_{number}"
        frames.mkdir(parents=True)
        write_simulation(scene, need_asperities(scene, "a benchmark"), frames)
        command = ["process", str(frames), "-o", str(run), "--no-pictures", "--quiet", "--workers", "1"]
        if contactimg(command) != 0:
            raise RuntimeError(f"{frames} could not be measured")
        runs.append(str(run))
    return runs


def with_load_noise(run: str, relative: float, rng: np.random.Generator) -> None:
    """Falsify the loads that a run knows of."""
    path = Path(run) / "frames.csv"
    text = pd.read_csv(path, dtype={"message": str})
    text["load_N"] *= 1 + relative * rng.standard_normal(len(text))
    text.to_csv(path, index=False)


def compare(analysis: Analysis) -> dict[str, float]:
    """Measured against the model's own contacts, in stated standard uncertainties and in percent."""
    laws, contact = analysis.area_laws, analysis.contact_laws
    measured, own = laws["measured"].exponent, laws["coupled"].exponent
    out = {
        "A(P) exponent": measured.value,
        "own": own.value,
        "std": measured.std,
        "difference/std": (measured.value - own.value) / measured.std,
    }
    for quantity in ("density", "mean_radius"):
        found, truth = (contact[quantity, model].single.exponent for model in ("measured", "coupled"))
        out |= {f"{quantity} exponent": found.value, f"{quantity} own": truth.value}
        out[f"{quantity} difference/std"] = (found.value - truth.value) / found.std
    columns = ["frame", "r_over_hertz_radius"]
    table = analysis.normalised.set_index(columns)
    own_part = table.loc[table["model"] == "coupled", ["pressure_over_hertz"]].add_suffix("_own")
    pair = table[table["model"] == "measured"].join(own_part)
    away = pair["pressure_over_hertz"] - pair["pressure_over_hertz_own"]
    std = pair["pressure_std_over_hertz"]
    out["p(r) worst difference/p0"] = away.abs().max()
    out["p(r) worst difference/std"] = (away.abs() / std)[std > 0].max()
    areas = analysis.area.set_index(["model", "load_N"])["area_m2"]
    out["A worst difference %"] = 100 * (areas["measured"] / areas["coupled"] - 1).abs().max()
    return out


def frames(places: int = 4, seed: int = 20000) -> None:
    """Rendered frames against their own contacts, all places together, one place, and with noisy loads."""
    results = {}
    for name, coverage in SURFACES.items():
        with tempfile.TemporaryDirectory() as top:
            runs = measured_places(Path(top), coverage, places, seed)
            opened = [open_place(run) for run in runs]
            results[f"{name}, {places} places"] = compare(analyse_places(opened, AnalysisOptions()))
            results[f"{name}, 1 place"] = compare(analyse_places(opened[:1], AnalysisOptions()))
            rng = np.random.default_rng(seed)
            for run in runs:
                with_load_noise(run, 0.1, rng)
            noisy = AnalysisOptions(load_relative_std=0.1, models=False)
            law = analyse_places([open_place(run) for run in runs], noisy).area_laws["measured"].exponent
            results[f"{name}, {places} places"] |= {
                "exponent, 10 % on P": law.value,
                "std, 10 % on P": law.std,
            }
    print(pd.DataFrame(results).round(4).to_string())


def solved_patterns(kind: str, count: int, seed: int, store: Path | None) -> pd.DataFrame:
    """Contacts of random patterns at each load; read from a file of the store if it is there."""
    path = None if store is None else store / f"{kind}_{seed}_{count}.npz"
    if path is not None and path.is_file():
        return pd.DataFrame(dict(np.load(path)))
    name, coverage = KINDS[kind]
    where = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (SIDE / 2, SIDE / 2)}
    tables = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        asperities = generate_asperities(name, side=SIDE, coverage=coverage, rng=rng)
        for load, solution in zip(LOADS_N, solve_loads(asperities, loads=LOADS_N, **where), strict=True):
            contacts = solution.contacts(f"{load}")[["x_m", "y_m", "radius_m", "force_N"]]
            tables.append(contacts.assign(pattern=number, load_N=load))
    table = pd.concat(tables, ignore_index=True)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **{column: table[column].to_numpy() for column in table})
    return table


def with_radius_errors(contacts: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Contacts as they are measured, to `RADIUS_STD`, with Hertz forces of these radii."""
    a = contacts["radius_m"].to_numpy()
    measured = np.maximum(a + RADIUS_STD * rng.standard_normal(a.size), 0.1 * RADIUS_STD)
    force = contacts["force_N"] * (measured / a) ** 3
    return contacts.assign(radius_m=measured, force_N=force, area_m2=np.pi * measured**2)


def half_width_68(estimate: Estimate) -> float:
    """Half the 68 % interval of a value whose 95 % interval is Student's."""
    if not estimate.std > 0:
        return 0.0
    wide = (estimate.high - estimate.low) / (2 * estimate.std)
    if not stats.t.ppf(0.975, 1e6) < wide < stats.t.ppf(0.975, 1):
        return estimate.std
    freedom = optimize.brentq(lambda n: stats.t.ppf(0.975, n) - wide, 1.0, 1e6)
    return float(estimate.std * stats.t.ppf(stats.norm.cdf(1.0), freedom))


def describe(estimates: list[Estimate], truth: float) -> dict[str, float]:
    """How intervals lie about the truth."""
    values = np.array([estimate.value for estimate in estimates])
    halves = np.array([half_width_68(estimate) for estimate in estimates])
    return {
        "truth": truth,
        "mean": values.mean(),
        "scatter": values.std(ddof=1),
        "mean stated std": np.mean([estimate.std for estimate in estimates]),
        "within 1 std": np.mean([abs(estimate.value - truth) < estimate.std for estimate in estimates]),
        "coverage of 68 %": np.mean(np.abs(values - truth) < halves),
        "coverage of 95 %": np.mean([estimate.low <= truth <= estimate.high for estimate in estimates]),
        "intervals": len(values),
    }


@dataclass(frozen=True)
class Bank:
    """Contacts of many patterns of one kind: sums over annuli and sectors of each load, and the areas."""

    moments: list[list[pd.DataFrame]]
    areas: list[pd.DataFrame]

    @classmethod
    def of(cls, kind: str, count: int, seed: int, store: Path | None) -> "Bank":
        """Solve the patterns, or read them, and measure their contacts."""
        bank, where = cls([], []), {"centre": (SIDE / 2, SIDE / 2), "edges": 2.5e-4 * np.arange(20)}
        patterns = solved_patterns(kind, count, seed, store)
        for number, place in patterns.groupby("pattern"):
            found = with_radius_errors(place, np.random.default_rng([seed, number, 1]))
            shots = [found[found["load_N"] == load] for load in LOADS_N]
            bank.moments.append([annulus_moments(shot, sectors=SECTORS, **where) for shot in shots])
            frames = pd.DataFrame({"frame": LOADS_N, "load_N": LOADS_N, "area_std_m2": 0.0})
            frames["area_m2"] = [shot["area_m2"].sum() for shot in shots]
            contacts = found.assign(frame=found["load_N"])
            bank.areas.append(frame_areas(frames, contacts, place="", centre=where["centre"]))
        return bank

    def expected(self, count: int) -> list[dict[str, pd.DataFrame]]:
        """What ``count`` places show on average: the mean over the bank, times their number."""
        whole = [sum_moments(place[k] for place in self.moments) for k in range(len(LOADS_N))]
        columns = list(MOMENTS)
        share = count / len(self.moments)
        return [{"mean": table.assign(**{name: share * table[name] for name in columns})} for table in whole]

    def drawn(self, places: NDArray[np.intp]) -> tuple[list[dict[str, pd.DataFrame]], pd.DataFrame]:
        """Sums of each load and areas of some of the patterns."""
        loads = [
            {str(i): self.moments[k][load] for i, k in enumerate(places)} for load in range(len(LOADS_N))
        ]
        areas = [self.areas[k].assign(place=str(i)) for i, k in enumerate(places)]
        return loads, pd.concat(areas, ignore_index=True)

    def mean_areas(self) -> pd.DataFrame:
        """Areas averaged over the bank."""
        together = pd.concat(self.areas).groupby("frame", as_index=False, sort=False)
        return together.mean(numeric_only=True).assign(place="all")

    def fitted(self, loads: list[dict[str, pd.DataFrame]], areas: pd.DataFrame) -> dict[str, PowerLaw]:
        """Each law."""
        found = {"A(P)": fit_area_law(areas)}
        return found | {name: fit_contact_law(loads, quantity).single for name, quantity in LAWS.items()}


def contacts(  # noqa: PLR0917 - options
    kinds: tuple[str, ...] = tuple(KINDS),
    counts: tuple[int, ...] = (1, 24),
    repeats: int = 100,
    bank: int = 240,
    seed: int = 20000,
    store: str | None = None,
) -> None:
    """How often intervals hold what as many places give on average over many patterns of the kind.

    ``repeats`` surfaces are drawn of each kind, of as many places as the ``counts`` say, from ``bank``
    patterns; ``store`` is a folder that keeps the solved patterns for the next run.
    """
    for kind in kinds:
        patterns = Bank.of(kind, bank, seed, None if store is None else Path(store))
        print(coverage_of(kind, patterns, counts, repeats, seed).round(4).T.to_string(), "\n", flush=True)


def coverage_of(kind: str, bank: Bank, counts: Sequence[int], repeats: int, seed: int) -> pd.DataFrame:
    """The rows of a kind."""
    rows = {}
    for count in counts:
        rng, expected = np.random.default_rng([seed, count]), bank.expected(count)
        truth = bank.fitted(expected, bank.mean_areas())
        pressure = np.array([places["mean"]["p"] / places["mean"]["area"] for places in expected])
        surfaces, inside = [], []
        for repeat in range(repeats):
            once = count == 1 and repeats <= len(bank.moments)
            places = np.array([repeat]) if once else rng.integers(len(bank.moments), size=count)
            loads, areas = bank.drawn(places)
            surfaces.append(bank.fitted(loads, areas))
            inside.append(profile_hits(loads, pressure))
        for name in truth:
            found = [surface[name].exponent for surface in surfaces]
            rows[f"{kind}, {name}, {count} places"] = describe(found, truth[name].exponent.value)
        rows[f"{kind}, p(r), {count} places"] = profile_coverage(np.array(inside), expected)
    return pd.DataFrame(rows).T


def profile_hits(loads: list[dict[str, pd.DataFrame]], pressure: Values) -> NDArray[np.bool_]:
    """Whether p(r) lies within 1 stated uncertainty and in the 95 % interval, shape (2, loads, annuli)."""
    found = [average_profile(list(places.values()), frame="", model="") for places in loads]
    names = ("pressure_Pa", "pressure_std_Pa", "pressure_low_Pa", "pressure_high_Pa")
    value, std, low, high = (np.array([table[name] for table in found], float) for name in names)
    return np.array([np.abs(value - pressure) <= std, (low <= pressure) & (pressure <= high)])


def profile_coverage(inside: NDArray[np.bool_], expected: list[dict[str, pd.DataFrame]]) -> dict[str, float]:
    """Coverage over annuli of all loads with three contacts or more on average: the mean, and the worst.

    Also over sparse annuli, with half a contact to three.
    """
    number = np.array([places["mean"]["n"] for places in expected])
    one, two = inside.mean(axis=0)
    held, sparse = number >= 3, (number >= 0.5) & (number < 3)
    found = {"within 1 std": one[held].mean(), "least within 1 std": one[held].min()}
    found |= {"coverage of 95 %": two[held].mean(), "worst annulus": two[held].min()}
    if sparse.any():
        found |= {"sparse, within 1 std": one[sparse].mean(), "sparse annuli": two[sparse].mean()}
    return found


def tables(repeats: int = 1000, seed: int = 20000) -> None:
    """How often intervals from simulated tables hold the truth that they were made from."""
    rng = np.random.default_rng(seed)
    laws = [broken_law(rng) for _ in range(repeats)]
    straight = [broken_law(rng, low_exponent=0.4) for _ in range(repeats)]
    found = {
        "exponent below p*": describe([law.low_exponent for law in laws], 0.78),
        "exponent above p*": describe([law.high_exponent for law in laws], 0.4),
        "p* (Pa)": describe([law.break_x for law in laws], 50.0),
        "breaks found where there is one": {"mean": np.mean([law.supported for law in laws])},
        "breaks found where there is none": {"mean": np.mean([law.supported for law in straight])},
        "shear stress (MPa)": describe([shear_stress(rng) for _ in range(repeats)], 0.49),
        "contact angle (deg)": describe([contact_angle(rng) for _ in range(repeats)], 57.0),
    }
    print(pd.DataFrame(found).T.round(4).to_string())


def broken_law(rng: np.random.Generator, low_exponent: float = 0.78) -> BrokenLaw:
    """Thirty points with 10 % on both axes about a law that breaks at 50 Pa."""
    p = np.geomspace(2.0, 2e5, 30)
    y = np.where(p < 50, (p / 50) ** low_exponent, (p / 50) ** 0.4)
    noise = 0.1 * rng.standard_normal((2, len(p)))
    return fit_broken_law(p * (1 + noise[0]), y * (1 + noise[1]), x_std=0.1 * p, y_std=0.1 * y)


def shear_stress(rng: np.random.Generator) -> Estimate:
    """Eight loads with 2 % on the area and 10 mN on the friction; MPa."""
    area = np.linspace(1e-7, 8e-7, 8)
    table = pd.DataFrame(
        {
            "area_m2": area * (1 + 0.02 * rng.standard_normal(8)),
            "area_std_m2": 0.02 * area,
            "friction_N": 0.49e6 * area + 0.01 * rng.standard_normal(8),
        }
    )
    return scaled(fit_shear_stress(table, friction_std=0.01).stress, 1e-6)


def contact_angle(rng: np.random.Generator) -> Estimate:
    """119 caps of 57 degrees with 5 % on the radius and 0.5 um on the height; degrees."""
    height = np.clip(rng.normal(29.6e-6, 10.1e-6, 119), 5e-6, None)
    radius = height / (1 - np.cos(np.radians(57.0)))
    table = pd.DataFrame(
        {
            "height_m": height + 0.5e-6 * rng.standard_normal(119),
            "radius_m": radius * (1 + 0.05 * rng.standard_normal(119)),
            "height_std_m": 0.5e-6,
            "radius_std_m": 0.05 * radius,
        }
    )
    return scaled(describe_topography(table).contact_angle, np.degrees(1.0))


def scaled(estimate: Estimate, factor: float) -> Estimate:
    """The estimate in another unit."""
    return Estimate(
        *(factor * value for value in (estimate.value, estimate.std, estimate.low, estimate.high))
    )
