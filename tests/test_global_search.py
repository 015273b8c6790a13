"""The camera is found anywhere over the sample, and chance agreement and lattices find no pose."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.files import Run, read_scene, write_scene
from contactimg.pipeline.measured_series import find_pose
from contactimg.pose import Pose
from contactimg.pose.fit import fit_pose
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities
from contactimg.tables import CONTACTS, FRAMES

SHAPE = (900, 1000)
GUESS = Pose(SHAPE, 6e-6)
SHIFT = 3e-4


@pytest.fixture(scope="module")
def targets():
    return generate_asperities("SA", side=6e-3, rng=np.random.default_rng(3))[["x_m", "y_m"]].to_numpy()


def contacts_near(targets, pose, place_px, count, rng):
    """The contacts closest to a place in the image, with noise and a few spurious ones."""
    x_px, y_px = pose.to_pixels(*targets.T)
    nearest = np.argsort(np.hypot(x_px - place_px[0], y_px - place_px[1]))[:count]
    noise, spurious = rng.normal(0, 0.3, (2, count)), rng.uniform(0, 900, (2, count // 15))
    return np.concatenate([np.stack([x_px[nearest], y_px[nearest]]) + noise, spurious], axis=1)


@pytest.mark.parametrize(
    ("turn_deg", "mirrored", "scale", "count"),
    [(0, False, 1.0, 12), (2, False, 1.02, 100), (91, True, 0.985, 60), (-90, False, 1.0, 100)],
)
def test_the_camera_is_found_wherever_it_looks(targets, turn_deg, mirrored, scale, count):
    rng = np.random.default_rng(17)
    truth = Pose(SHAPE, 6e-6 * scale, (0.0035, 0.0024), np.deg2rad(turn_deg), mirrored)
    x_px, y_px = contacts_near(targets, truth, (480, 430), count, rng)
    fit = fit_pose(x_px, y_px, targets, GUESS, largest_shift=SHIFT)
    assert fit.fitted
    assert fit.n_matched >= count
    corners = np.array([[200.0, 700.0], [200.0, 700.0]])
    apart = np.hypot(*np.subtract(fit.pose.to_sample(*corners), truth.to_sample(*corners)))
    # noise of 0.3 px, seen from beyond the contacts: some pixels where there are few
    assert apart.max() < (4 if count < 50 else 1) * 6e-6


def test_a_camera_at_the_stated_place_that_is_mirrored_or_of_another_scale_is_told(targets, caplog):
    truth = Pose(SHAPE, 6e-6, (0.0035, 0.0024), mirrored=True)
    x_px, y_px = contacts_near(targets, truth, (480, 430), 60, np.random.default_rng(17))
    contacts = CONTACTS.conform(pd.DataFrame({"frame": "a.tif", "x_px": x_px, "y_px": y_px}))
    frames = FRAMES.conform(pd.DataFrame({"frame": ["a.tif"], "n_contacts": [len(x_px)]}))
    sites = pd.DataFrame(targets, columns=["x_m", "y_m"])
    for mirrored in (True, False):
        assert "mirrored" not in caplog.text
        run = Run(scene_from_dict({}), contacts, frames)
        assert find_pose(run, sites, replace(truth, mirrored=mirrored)).pose.mirrored
    assert "mirrored = true: used here" in caplog.text
    assert "pixel_size_m" not in caplog.text
    found = find_pose(run, sites, replace(truth, pixel_size=6.4e-6))
    assert found.pose.pixel_size == pytest.approx(6e-6, rel=1e-3)
    assert "not 6.4e-06: used here" in caplog.text


def test_no_pose_is_found_by_chance(targets):
    rng = np.random.default_rng(23)
    for count in (5, 12, 60):
        found = fit_pose(*rng.uniform(0, 900, (2, count)), targets, GUESS, largest_shift=SHIFT)
        assert (found.fitted, found.pose) == (False, GUESS)


def test_a_lattice_has_no_single_pose():
    lattice = np.stack(np.meshgrid(np.arange(30), np.arange(30)), -1).reshape(-1, 2) * 2e-4
    x_px, y_px = contacts_near(
        lattice, Pose(SHAPE, 6e-6, (0.003, 0.003)), (500, 450), 60, np.random.default_rng(1)
    )
    assert not fit_pose(x_px, y_px, lattice, GUESS, largest_shift=SHIFT).fitted


def without_place(folder, **asperities):
    """The scene without the keys that say where the camera looks."""
    source = {name: dict(keys) for name, keys in read_scene(folder).source.items()}
    for section, key in (("indenter", "apex_m"), ("camera", "centre_m")):
        source[section].pop(key, None)
    source["asperities"] |= asperities
    write_scene(source, folder / "scene.toml")
    return folder


def test_process_finds_the_camera_that_the_scene_does_not_place(small_series, tmp_path, capsys):
    folder = without_place(copy_of(small_series, tmp_path / "frames"))
    assert main(["process", str(folder), "-o", str(tmp_path / "out"), "--no-pictures", "--quiet"]) == 0
    assert "centre_m" not in capsys.readouterr().err  # nothing was stated that this contradicts
    contacts = pd.read_csv(tmp_path / "out" / "contacts.csv")
    assert contacts["asperity"].notna().mean() > 0.95
    assert set(pd.read_csv(tmp_path / "out" / "frames.csv")["status"]) == {"ok"}


def test_where_no_pose_is_found_the_status_says_so_and_overlay_refuses(small_series, tmp_path, capsys):
    folder = without_place(copy_of(small_series, tmp_path / "frames"))
    table = pd.read_csv(folder / "asperities.csv")
    table[["x_m", "y_m"]] = np.random.default_rng(2).uniform(0, table[["x_m", "y_m"]].max(), (len(table), 2))
    table.to_csv(folder / "asperities.csv", index=False)
    assert main(["process", str(folder), "-o", str(tmp_path / "out"), "--no-pictures", "--quiet"]) == 1
    frames = pd.read_csv(tmp_path / "out" / "frames.csv")
    assert "no pose" in set(frames["status"])
    assert frames["message"].str.contains("centre_m").any()
    capsys.readouterr()
    assert main(["overlay", str(tmp_path / "out"), "--quiet"]) == 2
    assert "apex_m" in capsys.readouterr().err
