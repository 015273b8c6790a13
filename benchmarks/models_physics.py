"""What the models say about the experiment: p(r), eta(p) and mean radius over many SA+ patterns.

python benchmarks/models_physics.py [--patterns 1000] [--workers 1] [--figure FILE]

Annuli of 0.25 mm as in the paper (Yashima et al., doi:10.1039/C4SM02346C). E = 3 MPa, nu = 0.5, a lens of
128.8 mm.
"""

import argparse

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from contactimg import UniformHeights, hertz, solve_ensemble, solve_greenwood_tripp

LENS, MODULUS, LOADS = 0.1288, 4e6, (0.02, 0.2, 0.5)
WIDTH, RINGS = 0.25e-3, 20
FINE = 10  # narrow annuli in a wide one, for the steep fall at the edge
LEVELS = {"none": "uncoupled", "asymptotic": "coupled"}


def gather(patterns: int, workers: int) -> dict:
    """Sums over the patterns: force, contacts and radii in each annulus; density of asperities."""
    edges = WIDTH / FINE * np.arange(RINGS * FINE + 1)
    sums = {(level, load): np.zeros((3, RINGS * FINE)) for level in LEVELS for load in LOADS}
    asperities = 0
    for member in solve_ensemble(
        "SA",
        patterns=patterns,
        loads=LOADS,
        side=1e-2,
        indenter_radius=LENS,
        contact_modulus=MODULUS,
        seed=2015,
        workers=workers,
    ):
        for key, solution in member.solutions.items():
            rows = solution.touching
            r = np.hypot(solution.x[rows] - 5e-3, solution.y[rows] - 5e-3)
            for k, weights in enumerate((solution.force[rows], np.ones(rows.size), solution.radius[rows])):
                sums[key][k] += np.histogram(r, edges, weights=weights)[0]
        asperities += solution.force.size
    result = {"density": asperities / patterns / 1e-4}
    for step, name in ((FINE, "wide"), (1, "narrow")):
        rings = np.diff(np.pi * edges[::step] ** 2) * patterns
        result[name] = {"r": 0.5 * (edges[::step][1:] + edges[::step][:-1])}
        for key, narrow in sums.items():
            force, count, radius = narrow.reshape(3, -1, step).sum(axis=2)
            mean = np.full(count.size, np.nan)
            mean[count > 0] = radius[count > 0] / count[count > 0]
            result[name][key] = {"p": force / rings, "eta": count / rings, "a": mean, "count": count}
    return result


def exponents(data: dict, low: float, high: float) -> tuple[float, float, int]:
    """Slopes of log eta and log a against log p over annuli of enough contacts, all loads together."""
    p, eta, a, count = (
        np.concatenate([data["narrow"]["asymptotic", load][name] for load in LOADS])
        for name in ("p", "eta", "a", "count")
    )
    use = (count >= 30) & (p > low) & (p < high)
    if use.sum() < 3:
        return np.nan, np.nan, int(use.sum())
    x = np.log(p[use])
    return np.polyfit(x, np.log(eta[use]), 1)[0], np.polyfit(x, np.log(a[use]), 1)[0], int(use.sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patterns", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--figure")
    options = parser.parse_args()
    data = gather(options.patterns, options.workers)
    print(f"asperity density {data['density']:.5g} /m2, {options.patterns} patterns")
    figure, axes = plt.subplots(1, 4, figsize=(16, 3.8), layout="constrained")
    for ax, load in zip(axes, LOADS, strict=False):
        p0 = float(hertz.peak_pressure(load, sphere_radius=LENS, contact_modulus=MODULUS))
        a_hertz = float(hertz.radius(load, sphere_radius=LENS, contact_modulus=MODULUS))
        rings = solve_greenwood_tripp(
            UniformHeights(30e-6, 60e-6),
            density=data["density"],
            radius=1e-4 * LENS / (LENS + 1e-4),
            indenter_radius=LENS,
            contact_modulus=MODULUS,
            load=load,
        )
        line = [f"P {load} N  p/p0 in the first two annuli:"]
        for level, name in LEVELS.items():
            p = data["wide"][level, load]["p"] / p0
            line.append(f"{name} {p[0]:.3f} {p[1]:.3f}")
            colour = "tab:green" if name == "coupled" else "tab:red"
            ax.plot(data["wide"]["r"] / a_hertz, p, "o", ms=4, color=colour, label=name)
        line.append(f"GT at the centre {rings.pressure[0] / p0:.4f}")
        print("  ".join(line))
        ax.plot(rings.r / a_hertz, rings.pressure / p0, "k-", label="Greenwood-Tripp")
        t = np.linspace(0, 1, 200)
        ax.plot(t, np.sqrt(1 - t**2), "k:", label="Hertz")
        ax.set(xlim=(0, 2.5), xlabel="r / a_Hertz", ylabel="p / p0", title=f"P = {load} N")
    axes[0].legend()
    for low, high in ((1, 50), (50, 500), (200, 1e5), (500, 1e5), (1e3, 1e5)):
        slope_eta, slope_a, n = exponents(data, low, high)
        print(
            f"p in {low:g}-{high:g} Pa: eta ~ p^{slope_eta:.3f}, mean radius ~ p^{slope_a:.3f} ({n} annuli)"
        )
    for load in LOADS:
        one = data["narrow"]["asymptotic", load]
        axes[3].loglog(one["p"], one["eta"] * 1e-6, "o", ms=2, label=f"eta (1/mm2), {load} N")
        axes[3].loglog(one["p"], one["a"] * 1e6, "s", ms=2, mfc="none", label=f"mean radius (um), {load} N")
    axes[3].set(xlabel="p (Pa)")
    axes[3].legend(fontsize=7)
    if options.figure:
        figure.savefig(options.figure, dpi=110)


if __name__ == "__main__":
    main()
