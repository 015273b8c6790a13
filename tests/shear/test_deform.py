"""Sheared series: true contacts follow the laws of the scene, and loads.csv holds what was applied."""

import numpy as np
import pandas as pd
import pytest
from helpers.small_series import TINY, write_small_series

from contactimg.errors import InputError
from contactimg.files import read_frames
from contactimg.files.tables import read_loads
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict
from contactimg.shear.laws import shear_contacts

SHEAR = {"tangential_N": [0.0, 0.001, -0.002], "shear_beta_m5_N2": 4e-17, "shear_compliance_m_N": 1e-3}


def test_area_axes_and_places_follow_the_scene():
    scene = scene_from_dict(
        {
            "load": {"tangential_direction_deg": 30.0},
            "simulate": SHEAR | {"loads_N": [1.0, 1.0, 1.0]},
        }
    )
    radius = np.array([10e-6, 20e-6])
    area = np.pi * radius**2
    disks = pd.DataFrame({"x_m": 0.0, "y_m": 0.0, "radius_m": radius, "area_m2": area})
    sheared = shear_contacts(disks, scene, tangential=-0.001)
    # q_i = Q A_i/sum A: the smaller has a fifth of the load; A = A0 - beta A0^(-3/2) q^2
    force = np.array([0.0002, 0.0008])
    expected = area - 4e-17 * area**-1.5 * force**2
    assert sheared["area_m2"].to_numpy() == pytest.approx(expected, rel=1e-12)
    assert (np.pi * sheared["semi_major_m"] * sheared["semi_minor_m"]).to_numpy() == pytest.approx(expected)
    assert sheared["semi_major_m"].tolist() == radius.tolist()
    # the major axis is across the load, and 1 um of displacement is against its positive sense
    assert np.degrees(sheared["angle_rad"]).to_numpy() == pytest.approx(-60)
    assert sheared["x_m"].to_numpy() == pytest.approx(-1e-6 * np.cos(np.pi / 6))
    assert sheared["y_m"].to_numpy() == pytest.approx(-0.5e-6)
    # alone, the smaller one would lose all its area: beta A^(-5/2) q^2 = 4e-17 (3.1e-10)^(-5/2) 1e-4 = 2.3
    assert shear_contacts(disks.iloc[:1], scene, tangential=0.01).empty


def test_a_sheared_series_is_written_with_its_loads_times_and_ellipses(tmp_path):
    scene = TINY | {"effects": {"model": "paper", "film": "off"}}
    folder = write_small_series(tmp_path / "sheared", scene, **SHEAR, interval_s=0.5, position_drift_px=0.0)
    plain = write_small_series(tmp_path / "plain", scene, position_drift_px=0.0)
    loads = read_loads(folder / "loads.csv")
    assert loads["tangential_N"].tolist() == SHEAR["tangential_N"]
    assert loads["time_s"].tolist() == [0.0, 0.5, 1.0]
    assert (plain / "loads.csv").read_text().splitlines()[0] == "frame,load_N,friction_N,velocity_m_s"
    truth, before = (pd.read_csv(one / "truth.csv") for one in (folder, plain))
    both = truth.merge(before, on=["frame", "asperity"], suffixes=("", "_before"))
    shift = (both["x_m"] - both["x_m_before"]).groupby(both["frame"]).mean().to_numpy()
    assert shift == pytest.approx([0.0, 1e-6, -2e-6], abs=1e-12)
    pixel = TINY["camera"]["pixel_size_m"]
    sheared = both[both["frame"] != "frame_1.tif"]
    assert (sheared["shape"] == "ellipse").all()
    assert (sheared["semi_minor_px"] * pixel).to_numpy() == pytest.approx(sheared["semi_minor_m"].to_numpy())
    # the first frame has no tangential load, and the same pixels as without
    first, same = (next(iter(read_frames(one / "frame_1.tif"))).image for one in (folder, plain))
    assert np.array_equal(first, same)


def test_tangential_loads_need_asperities_and_one_value_a_frame(tmp_path):
    with pytest.raises(InputError, match="one value for each of the 2 loads_N, got 1"):
        scene_from_dict({"simulate": {"loads_N": [0.1, 0.2], "tangential_N": [0.1]}})
    smooth = {key: value for key, value in TINY.items() if key != "asperities"}
    scene = scene_from_dict(smooth | {"simulate": TINY["simulate"] | SHEAR})
    with pytest.raises(InputError, match="tangential_N needs asperities"):
        write_simulation(scene, None, tmp_path)
