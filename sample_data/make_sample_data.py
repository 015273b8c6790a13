"""Make synthetic sample data again, and bring the table of checksums in README.md up to date.

    python sample_data/make_sample_data.py [FOLDER ...]

Each folder is simulated from the TOML file of its name, all by default; `pins/` holds camera images made
elsewhere and is left alone.
"""

import argparse
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.effects.solve_without import MECHANICAL_EFFECTS
from contactimg.files import read_scene, read_table, write_scene, write_table
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities
from contactimg.tables import ASPERITIES, CONTACTS, LOADS, TOPOGRAPHY

HERE = Path(__file__).parent
TABLE_HEAD = "| file | bytes | origin | sha256 |\n|---|---|---|---|\n"
NOT_DATA = {"README.md", "make_sample_data.py"}


def make_sa_plus() -> None:
    """Solve and render the scene at its loads."""
    scene = read_scene(HERE / "sa_plus.toml")
    folder = HERE / "sa_plus"
    folder.mkdir(exist_ok=True)
    write_simulation(scene, need_asperities(scene, "the sample data"), folder)
    write_scene(_free_mechanics(read_scene(folder).source), folder / "scene.toml")


def _free_mechanics(made: dict[str, Any]) -> dict[str, Any]:
    """A scene that says what its frames show, and leaves the mechanics to who asks."""
    shown = {name: switch for name, switch in made["effects"].items() if name not in MECHANICAL_EFFECTS}
    return made | {"effects": {"model": "paper"} | shown}


PLACES_M = [(3.5e-3, 3.5e-3), (6.5e-3, 3.5e-3), (3.5e-3, 6.5e-3), (6.5e-3, 6.5e-3)]
"""Where the lens presses on the pattern of sa_plus_places/."""

SHEAR_STRESS_PA, FRICTION_STD_N, VELOCITY_M_S = 0.49e6, 5e-3, 0.5e-3
"""The friction of ra_plus/ is the stress times the true area, with this noise, at this velocity."""


def make_sa_plus_places() -> None:
    """Press the lens on four places of one pattern."""
    recipe = read_scene(HERE / "sa_plus_places.toml")
    folder = HERE / "sa_plus_places"
    folder.mkdir(exist_ok=True)
    asperities = need_asperities(recipe, "the sample data")
    write_table(asperities, ASPERITIES, folder / "asperities.csv")
    for number, apex in enumerate(PLACES_M, start=1):
        data = {section: dict(keys) for section, keys in recipe.source.items()}
        data["indenter"]["apex_m"] = list(apex)
        data["simulate"]["seed"] += number
        place = folder / f"place_{number}"
        place.mkdir(exist_ok=True)
        write_simulation(scene_from_dict(data), asperities, place)
        (place / "asperities.csv").unlink()
        made = read_scene(place).source
        made["asperities"]["file"] = "../asperities.csv"
        write_scene(_free_mechanics(made), place / "scene.toml")


def make_ra_plus() -> None:
    """Simulate a rough lens, slide it, and hide from the scene what an experimenter would not know."""
    recipe = read_scene(HERE / "ra_plus.toml")
    folder = HERE / "ra_plus"
    folder.mkdir(exist_ok=True)
    asperities = need_asperities(recipe, "the sample data")
    write_simulation(recipe, asperities, folder)
    (folder / "asperities.csv").replace(folder / "truth_asperities.csv")
    made = read_scene(folder).source
    density = len(asperities) / recipe.asperities.side**2
    made["asperities"] = {"textured": "rigid", "density_per_m2": density}
    write_scene(_free_mechanics(made), folder / "scene.toml")
    rng = np.random.default_rng(recipe.asperities.seed + 1)
    _add_friction(folder, rng)
    write_table(_profilometry(119, rng), TOPOGRAPHY, folder / "topography.csv")


def _add_friction(folder: Path, rng: np.random.Generator) -> None:
    """Friction of the true areas into loads.csv."""
    loads = read_table(folder / "loads.csv", LOADS)
    areas = read_table(folder / "truth.csv", CONTACTS).groupby("frame")["area_m2"].sum()
    noise = rng.normal(0.0, FRICTION_STD_N, len(loads))
    friction = SHEAR_STRESS_PA * areas.reindex(loads["frame"]).to_numpy() + noise
    write_table(loads.assign(friction_N=friction, velocity_m_s=VELOCITY_M_S), LOADS, folder / "loads.csv")


def _profilometry(count: int, rng: np.random.Generator) -> pd.DataFrame:
    """Heights and radii of other asperities of the same surface, with the errors of a profilometer."""
    caps = generate_asperities("RA+", side=0.004, rng=rng).sample(count, random_state=rng)
    height_std, radius_std = 0.5e-6, 0.05 * caps["radius_m"].to_numpy()
    return pd.DataFrame(
        {
            "height_m": caps["height_m"].to_numpy() + rng.normal(0.0, height_std, count),
            "radius_m": caps["radius_m"].to_numpy() + radius_std * rng.standard_normal(count),
            "height_std_m": height_std,
            "radius_std_m": radius_std,
        }
    )


LOAD_NOISE = 0.005
"""Of each load of smooth_jkr/, as its sensor reads it."""


def make_smooth_jkr() -> None:
    """Render the smooth contact, read its loads with noise, and hide what a calibration is to find."""
    recipe = read_scene(HERE / "smooth_jkr.toml")
    folder = HERE / "smooth_jkr"
    folder.mkdir(exist_ok=True)
    write_simulation(recipe, None, folder)
    made = read_scene(folder).source
    write_scene({name: made[name] for name in ("indenter", "camera", "images")}, folder / "scene.toml")
    loads = read_table(folder / "loads.csv", LOADS)
    rng = np.random.default_rng(recipe.simulate.seed + 1)
    loads["load_N"] *= 1 + LOAD_NOISE * rng.standard_normal(len(loads))
    write_table(loads, LOADS, folder / "loads.csv")


MAKERS = {
    "sa_plus": make_sa_plus,
    "sa_plus_places": make_sa_plus_places,
    "ra_plus": make_ra_plus,
    "smooth_jkr": make_smooth_jkr,
}


def data_files() -> list[Path]:
    """The files that belong to the sample data, outputs of the commands apart."""
    files = (path for path in HERE.rglob("*") if path.is_file())
    inside = ((path, path.relative_to(HERE).parts) for path in files)
    return sorted(
        path
        for path, parts in inside
        if path.name not in NOT_DATA and not {"contactimg_out", "__pycache__"} & set(parts)
    )


def describe_file(path: Path) -> str:
    """One row of the table."""
    name = path.relative_to(HERE).as_posix()
    if name.startswith(tuple(MAKERS)):
        origin = "synthetic"
    else:
        origin = "contactimg" if path.suffix == ".toml" else "9DTact"
    content = path.read_bytes()
    return f"| {name} | {len(content)} | {origin} | {hashlib.sha256(content).hexdigest()} |\n"


def update_readme() -> None:
    """Replace the table at the end of README.md."""
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8").split(TABLE_HEAD)[0]
    rows = "".join(describe_file(path) for path in data_files())
    readme.write_text(text + TABLE_HEAD + rows, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help=f"of {', '.join(MAKERS)}; default: all")
    for name in parser.parse_args().folders or MAKERS:
        MAKERS[name]()
    update_readme()
