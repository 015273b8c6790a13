"""The contact models against solutions of the whole contact problem (tests/helpers/spectral_contacts.py).

    python benchmarks/run.py models_truth.errors
    python benchmarks/run.py models_truth.make

For each stored pattern and load and each level of coupling: the error of the forces (sum of |dF| over the
load), of the area, of the radii (root mean square) and of the indentation, and what the plan of the effects
states for full coupling. ``make`` solves all cases again and stores them in tests/data (half an hour).
"""

import numpy as np
import pandas as pd
from spectral_truth import ASPERITIES, CASES, CONTACTS, MODULUS, Case, patterns, solved, stored_cases

from contactimg.effects.solve_without import estimate_mechanics
from contactimg.scene import scene_from_dict

LOADS = {
    "RA+": (0.02, 0.1, 0.6),
    "RA-": (0.02, 0.1),
    "RA+ other": (0.3,),
    "SA+": (0.02, 0.5),
    "SA+ flat": (0.02, 0.1),
    "RA+ flat": (0.05,),
}
DEGREE, TOLERANCE = 6, 1e-8


def make():
    """Solve and store every case."""
    made = patterns()
    pd.concat([t.assign(pattern=name) for name, (t, *_) in made.items() if name != "SA+"]).to_csv(
        ASPERITIES, index=False, float_format="%.12g"
    )
    rows, contacts = [], []
    for pattern, loads in LOADS.items():
        table, lens, apex = made[pattern]
        for load in loads:
            for law in ("hertz", "sphere"):
                case, misfit = solved(
                    Case(pattern, law, load, lens, apex, table), degree=DEGREE, tolerance=TOLERANCE
                )
                name = f"{pattern}, {load:g} N, {law}"
                print(f"{name}: misfit {misfit:.1g}", flush=True)
                rows.append((name, pattern, law, load, lens, *apex, case.indentation, misfit))
                on = np.flatnonzero(case.force)
                contacts.append(
                    pd.DataFrame(
                        {"case": name, "asperity": on, "force_N": case.force[on], "radius_m": case.radius[on]}
                    )
                )
    columns = ["case", "pattern", "law", "load_N", "lens_radius_m", "apex_x_m", "apex_y_m"]
    cases = pd.DataFrame(rows, columns=[*columns, "indentation_m", "misfit"])
    cases.to_csv(CASES, index=False, float_format="%.10g")
    pd.concat(contacts).to_csv(CONTACTS, index=False, float_format="%.9g")


def relative_errors(case, solution):
    """Relative errors of forces, area, radii and indentation."""
    area = float(np.sum(np.pi * case.radius**2))
    return (
        np.abs(solution.force - case.force).sum() / case.load,
        solution.area / area - 1,
        np.sqrt(np.sum((solution.radius - case.radius) ** 2) / np.sum(case.radius**2)),
        solution.indentation / case.indentation - 1,
    )


def stated(case):
    """What the plan says of full coupling."""
    indenter = {"radius_m": case.lens if np.isfinite(case.lens) else 1e6, "apex_m": list(case.apex)}
    scene = scene_from_dict({"indenter": indenter, "elastic": {"young_modulus_Pa": 0.75 * MODULUS}})
    found = estimate_mechanics(scene, case.table, load=case.load).model_error.errors
    return tuple(found[name] for name in ("force", "area", "radius", "indentation"))


def line(name, values):
    print(f"  {name:11s}" + "".join(f"{100 * value:12.5f}" for value in values))


def errors():
    """Print the errors of each stored case."""
    print("error, %:     " + "".join(f"{name:>12s}" for name in ("forces", "area", "radii", "indentation")))
    for case in stored_cases():
        print(f"{case.pattern}, {case.load:g} N, {case.law}, {np.count_nonzero(case.force)} contacts")
        for coupling in ("none", "asymptotic", "hertz", "full"):
            line(coupling, relative_errors(case, case.predict(coupling)))
        line("full, stated", stated(case))
