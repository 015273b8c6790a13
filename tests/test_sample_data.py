"""The sample data are what their README says, byte by byte, and hang together."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from contactimg.files import read_frames, read_scene
from contactimg.tables import ASPERITIES, CONTACTS

SAMPLE_DATA = Path(__file__).parents[1] / "sample_data"
SA_PLUS, PINS = SAMPLE_DATA / "sa_plus", SAMPLE_DATA / "pins"
NOT_DATA = {"README.md", "make_sample_data.py"}
LOADS = [0.02, 0.05, 0.1, 0.2, 0.35, 0.5]


def listed_files():
    """name -> (bytes, origin, sha256) of the table in the README."""
    lines = (SAMPLE_DATA / "README.md").read_text(encoding="utf-8").splitlines()
    start = lines.index("| file | bytes | origin | sha256 |") + 2
    rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines[start:])
    return {name: (int(size), origin, digest) for name, size, origin, digest in rows}


def test_every_file_is_listed_and_unchanged():
    found = {
        path.relative_to(SAMPLE_DATA).as_posix(): path.read_bytes()
        for path in SAMPLE_DATA.rglob("*")
        if path.is_file()
        and path.name not in NOT_DATA
        and not {"contactimg_out", "__pycache__"} & set(path.relative_to(SAMPLE_DATA).parts)
    }
    listed = listed_files()
    assert set(found) == set(listed)
    for name, content in found.items():
        assert (len(content), hashlib.sha256(content).hexdigest()) == (listed[name][0], listed[name][2]), name
    assert sum(map(len, found.values())) <= 20e6
    assert {origin for _, origin, _ in listed.values()} == {"synthetic", "9DTact", "contactimg"}


def test_frames_need_nothing_but_tifffile():
    # tifffile takes its own slow decoder where imagecodecs is missing
    program = (
        "import sys; sys.modules['imagecodecs'] = None\n"
        "import tifffile\n"
        "print(*tifffile.imread(sys.argv[1]).shape, tifffile.imread(sys.argv[1]).sum())"
    )
    answer = subprocess.run(  # noqa: S603
        [sys.executable, "-c", program, str(SA_PLUS / "reference.tif")],
        capture_output=True,
        text=True,
        check=True,
    )
    rows, columns, total = map(int, answer.stdout.split())
    image = next(iter(read_frames(SA_PLUS / "reference.tif"))).image
    assert (rows, columns) == image.shape == (1200, 1600)
    assert total == image.sum(dtype=np.int64)


def test_sa_plus_was_made_from_its_recipe():
    made, recipe = read_scene(SA_PLUS), read_scene(SAMPLE_DATA / "sa_plus.toml")
    for section in ("indenter", "elastic", "camera", "simulate"):
        assert getattr(made, section) == getattr(recipe, section)
    # what the frames show is written beside them; their contacts follow the paper's model
    assert made.effects == recipe.effects.model_copy(update={"model": "paper"})
    assert "auto" not in recipe.effects.model_dump().values()
    assert made.simulate.loads == LOADS
    assert pd.read_csv(SA_PLUS / "loads.csv")["load_N"].to_list() == LOADS


def test_truth_balances_the_loads_and_shows_one_shift_a_frame():
    truth = CONTACTS.conform(pd.read_csv(SA_PLUS / "truth.csv", dtype={"flags": str}).drop(columns="flags"))
    asperities = ASPERITIES.conform(pd.read_csv(SA_PLUS / "asperities.csv"))
    pose = read_scene(SA_PLUS).pose((1200, 1600))
    shifts = []
    for k, (name, contacts) in enumerate(truth.groupby("frame", sort=True)):
        assert name == f"frame_{k + 1}.tif"
        # the solver's tolerance on the load, and full precision in the file
        assert contacts["force_N"].sum() == pytest.approx(LOADS[k], rel=1e-9)
        x_px, y_px = pose.to_pixels(contacts["x_m"], contacts["y_m"])
        shift = np.array([contacts["x_px"] - x_px, contacts["y_px"] - y_px])
        assert np.ptp(shift, axis=1).max() < 1e-8  # rounding of positions of 1e3 px
        shifts.append(shift.mean(axis=1))
        # under a lens a contact stands a fraction R/(R + Rl) = 8e-4 nearer to the apex than its cap
        caps = asperities.loc[contacts["asperity"].to_numpy(int)]
        distance = np.hypot(
            caps["x_m"].to_numpy() - contacts["x_m"], caps["y_m"].to_numpy() - contacts["y_m"]
        )
        assert distance.max() < 8e-4 * 5e-3
    assert len(shifts) == 6
    assert 0.05 < np.std(shifts) < 1.0  # 12 draws of 0.3 px


def test_contacts_stand_out_where_the_truth_puts_them():
    truth = pd.read_csv(SA_PLUS / "truth.csv")
    frame = next(iter(read_frames(SA_PLUS / "frame_6.tif"))).image.astype(float)
    reference = next(iter(read_frames(SA_PLUS / "reference.tif"))).image.astype(float)
    large = truth[(truth["frame"] == "frame_6.tif") & (truth["radius_px"] > 3)]
    at = large["y_px"].round().astype(int), large["x_px"].round().astype(int)
    # 100 levels at the centre, 80 in the corners, 2 % more light; five standard deviations of 3 levels
    rise = frame[at] - reference[at]
    assert rise.min() > 80 - 15
    assert rise.max() < 102 + 15
    assert len(large) > 200


def test_pins_are_the_camera_images():
    assert "MIT License" in (PINS / "LICENSE.upstream").read_text(encoding="utf-8")
    frames = list(read_frames(PINS / "frame_1.png"))
    assert [frame.shape for frame in frames] == [(480, 640)]
    assert read_scene(PINS).images.polarity == "dark"
