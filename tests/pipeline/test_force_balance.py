"""A frame whose local forces do not balance its load is not ok."""

import numpy as np
import pandas as pd
import pytest
import tifffile
from small_series import copy_of

from contactimg.cli import main
from contactimg.effects.local_law import decide_law, law_evidence
from contactimg.files import Run, read_scene, write_scene
from contactimg.forces import sphere_radii
from contactimg.pipeline.measured_series import with_forces
from contactimg.pose.fit import PoseFit
from contactimg.scene import scene_from_dict
from contactimg.tables import CONTACTS, FRAMES


def processed(folder, out, modulus, load_factor=1.0):
    """Frames table of the second frame, with another modulus or load than it was rendered with."""
    source = {name: dict(keys) for name, keys in read_scene(folder).source.items()}
    source["elastic"] |= {"young_modulus_Pa": modulus}
    write_scene(source, folder / "scene.toml")
    loads = pd.read_csv(folder / "loads.csv")
    loads.assign(load_N=load_factor * loads["load_N"]).to_csv(folder / "loads.csv", index=False)
    frame = loads["frame"][1]
    words = ["process", str(folder), "-o", str(out), "--no-pictures", "--quiet", "--frames", str(frame)]
    code = main(words)
    row = pd.read_csv(out / "frames.csv").iloc[0]
    assert code == (0 if row["status"] == "ok" else 1)  # the only frame has no forces to rely on
    return row


@pytest.mark.parametrize(
    ("modulus", "load_factor", "status"),
    [
        (3.0e6, 1.0, "ok"),
        (2.4e6, 1.0, "ok"),  # a modulus that is not calibrated
        (9.0e6, 1.0, "forces off load"),
        (3.0e6, 0.5, "forces off load"),
    ],
)
def test_the_balance_of_forces_decides_the_status(small_series, tmp_path, modulus, load_factor, status):
    row = processed(copy_of(small_series, tmp_path / "frames"), tmp_path / "out", modulus, load_factor)
    assert row["status"] == status
    numbers = f"add up to {row['force_sum_N']:.3g} N at a load of {row['load_N']:.3g} N"
    assert (numbers in str(row["message"])) == (status != "ok")


RIGID = {
    "indenter": {"radius_m": "flat"},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"radius_m": 1e-4},
    "camera": {"pixel_size_m": 6.0e-6},
}


def balanced(load_over_forces, places, before="ok", **load):
    """Status and message of a frame of 200 x 200 pixels with equal contacts, under a load given by them.

    ``before`` is the status by the image alone.
    """
    contacts = CONTACTS.conform(pd.DataFrame(places, columns=["x_px", "y_px"]).assign(frame="a.tif"))
    contacts = contacts.assign(radius_px=4.0, radius_m=2.4e-5, radius_std_m=1e-7, area_m2=np.pi * 2.4e-5**2)
    # Hertz: P = 4/3 E* a^3 / R with E* = E/(1 - 1/4)
    forces = len(contacts) * 4 / 3 * 4e6 * 2.4e-5**3 / 1e-4
    row = {"frame": "a.tif", "status": before, "n_contacts": len(contacts)}
    row["load_N"] = load_over_forces * forces
    frames, scene = FRAMES.conform(pd.DataFrame([row])), scene_from_dict(RIGID | {"load": load})
    pose = PoseFit(scene.pose((200, 200)), fitted=False, n_points=0, n_matched=0, residual=np.nan)
    run = Run(scene, contacts, frames, pose)
    law = decide_law(scene, law_evidence(scene, contacts, sphere_radii(contacts, scene, None)))
    found = with_forces(run, None, law).frames.iloc[0]
    return found["status"], found["message"]


INSIDE = [(x, y) for x in (60, 100, 140) for y in (60, 100, 140)]
CUT = [(x, y) for x in (10, 60, 110, 160) for y in (30, 80, 130, 190)]


def test_forces_without_a_load_are_off_it():
    status, message = balanced(0.0, INSIDE)
    assert status == "forces off load"
    assert "N at a load of 0 N" in message
    assert balanced(0.0, INSIDE, zero_std_N=0.01) == ("ok", "")
    assert balanced(0.0, []) == ("ok", "")


def test_forces_off_their_load_are_said_whatever_else_is():
    assert balanced(5.0, INSIDE, before="poor fit")[0] == "forces off load"
    assert balanced(1.0, INSIDE, before="poor fit")[0] == "poor fit"
    assert balanced(5.0, INSIDE, before="no pose")[0] == "no pose"


def test_frames_that_cut_the_contact_say_what_is_missing(small_series, tmp_path, capsys):
    """Less than two thirds of the width: the forces add up to 82 % of the largest load."""
    folder, out = copy_of(small_series, tmp_path / "frames"), tmp_path / "out"
    for path in folder.glob("*.tif"):
        tifffile.imwrite(path, tifffile.imread(path)[:, :250])
    said = "contacts lie along the border: area and forces beyond it are missing"
    words = [str(folder), "-o"]
    assert main(["process", *words, str(out), "--no-pictures", "--quiet"]) == 0
    assert pd.read_csv(out / "frames.csv")["message"].str.contains(said).all()
    capsys.readouterr()
    for command in (["calibrate", "modulus", *words, str(tmp_path / "m")], ["analyse", str(out)]):
        assert main(command) == 0
        assert f"3 frames: {said}" in " ".join(capsys.readouterr().out.split())


def test_a_frame_that_shows_a_part_of_the_contact_bears_a_part_of_the_load():
    assert balanced(5.0, INSIDE)[0] == "forces off load"
    assert balanced(5.0, CUT) == ("ok", "")
    assert balanced(0.2, CUT)[0] == "forces off load"  # a part does not bear more than all
