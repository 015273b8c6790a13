"""How honest the uncertainties of area and sum of forces are: pulls over many frames, and a whole series.

Frames of the paper's pattern SA+ (1600 x 1200 pixels of 6 um, contrast 100 grey levels, noise 2.1), each with
another pattern, noise and texture; measured alone, or in a series that spans five decades of load.

    python benchmarks/sum_coverage.py [--frames N] [--mismatched M] [--first-seed S]
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from pattern_scene import PIXEL, pattern_scene

from contactimg.files import read_scene
from contactimg.forces import assign_forces, total_area, total_force
from contactimg.pipeline.frame import measure_frame
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.prediction import predict_contacts
from contactimg.render import render_contacts, render_reference

LOADS = [0.02, 0.2, 0.5]
SERIES = [1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.05, 0.2, 0.5]
RENDERED = {
    "as assumed": {},
    "20 % of the light in a wide halo": {"psf": "halo"},
    "Airy PSF": {"psf": "airy"},
    "rough edge, 0.3 px": {"edge_roughness_px": 0.3},
    "5 % brightness spread": {"brightness_spread": 0.05},
}


def pulls(seed: int, load: float, changes: dict) -> dict[str, float]:
    """Error over stated uncertainty, and relative error, of the two sums of one frame measured alone."""
    scene = pattern_scene(seed, **changes)
    asperities = need_asperities(scene, "a benchmark")
    truth = predict_contacts(scene, asperities, load=load).contacts
    radii = contact_sites(asperities, scene)["radius_m"].to_numpy()
    seeds = np.random.SeedSequence([seed, int(1e6 * load)]).spawn(2)
    frame = render_contacts(
        truth,
        scene,
        rng=np.random.default_rng(seeds[0]),
        sphere_radius=radii[truth["asperity"].to_numpy(int)],
    ).frame
    reference = render_reference(scene, rng=np.random.default_rng(seeds[1]))
    contacts = measure_frame(frame, reference, pixel_size=PIXEL, polarity="bright")
    found = assign_forces(contacts, float(radii.mean()), contact_modulus=scene.elastic.contact_modulus)
    sums = {"area": (total_area(found), truth["area_m2"].sum()), "force": (total_force(found), load)}
    return {"load": load} | {
        f"{name} {what}": value
        for name, (total, true) in sums.items()
        for what, value in (
            ("pull", (total.value - true) / total.std),
            ("error %", 100 * (total.value / true - 1)),
            ("stated %", 100 * total.std / true),
        )
    }


def coverage(seeds: range, load: float, changes: dict) -> dict[str, float]:
    """Mean and spread of errors and pulls of one kind of frame at one load."""
    table = pd.DataFrame([pulls(seed, load, changes) for seed in seeds])
    row = {"frames": len(seeds), "load": load}
    for what in ("area", "force"):
        row |= {
            f"{what}: bias %": table[f"{what} error %"].mean(),
            f"{what}: std %": table[f"{what} error %"].std(),
            f"{what}: stated %": table[f"{what} stated %"].mean(),
            f"{what}: pull": table[f"{what} pull"].mean(),
            f"{what}: pull std": table[f"{what} pull"].std(),
        }
    return row


def series(seed: int, blur: float) -> pd.DataFrame:
    """A series over five decades of load: errors of the sums and what is stated."""
    scene = pattern_scene(seed, blur_px=blur, loads_N=SERIES)
    with tempfile.TemporaryDirectory() as top:
        folder = Path(top) / "series"
        folder.mkdir()
        write_simulation(scene, need_asperities(scene, "a benchmark"), folder)
        run = measure_series(read_scene(folder), workers=1)
        truth = pd.read_csv(folder / "truth.csv").groupby("frame")["area_m2"].sum()
    frames = run.frames.set_index("frame")
    area, load = truth[frames.index], frames["load_N"]
    return pd.DataFrame(
        {
            "load": load,
            "area: error %": 100 * (frames["area_m2"] / area - 1),
            "area: stated %": 100 * frames["area_std_m2"] / area,
            "force: error %": 100 * (frames["force_sum_N"] / load - 1),
            "force: stated %": 100 * frames["force_sum_std_N"] / load,
        }
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--mismatched", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=1)
    options = parser.parse_args()
    first = options.first_seed
    for blur in (1.4, 2.5):
        print(f"series, blur {blur} px")
        print(series(first, blur).to_string(index=False, float_format="{:.3g}".format), flush=True)
    for name, changes in RENDERED.items():
        seeds = range(first, first + (options.mismatched if changes else options.frames))
        rows = pd.DataFrame([coverage(seeds, load, changes) for load in LOADS])
        print(name)
        print(rows.to_string(index=False, float_format="{:.2f}".format), flush=True)


if __name__ == "__main__":
    main()
