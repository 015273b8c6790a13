"""Slips in a scene, its tables and a calibration: each is refused with value, range and likely unit."""

from pathlib import Path

import pandas as pd
import pytest
from small_series import SCENE, copy_of

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import read_asperities, read_scene, read_scene_asperities, read_scene_loads
from contactimg.plausibility import (
    doubts_about_calibration,
    doubts_about_forces,
    doubts_about_scene,
    doubts_as_warnings,
    settle,
)
from contactimg.scene import scene_from_dict

SAMPLES = sorted((Path(__file__).parents[1] / "sample_data").glob("*/scene.toml"))


@pytest.fixture(scope="module")
def asperities(small_series):
    return read_asperities(small_series / "asperities.csv")


def changed(**sections):
    return scene_from_dict(SCENE | {name: SCENE.get(name, {}) | keys for name, keys in sections.items()})


def first_doubt(scene, asperities=None, loads=()):
    return next(iter(doubts_about_scene(scene, asperities, loads)), "")


def test_the_sound_scene_and_all_samples_are_plausible(asperities):
    assert list(doubts_about_scene(changed(), asperities, [0.005])) == []
    assert SAMPLES
    for path in SAMPLES:
        scene = read_scene(path)
        assert list(doubts_about_scene(scene, read_scene_asperities(scene), read_scene_loads(scene))) == [], (
            path
        )


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"elastic": {"young_modulus_Pa": 3.0}}, "young_modulus_Pa = 3 .* was it given in kPa or MPa or GPa"),
        ({"elastic": {"young_modulus_Pa": 0.003}}, "young_modulus_Pa = 0.003 .* 1000 .*MPa or GPa"),
        ({"elastic": {"poisson_ratio": 0.0005}}, r"poisson_ratio = 0\.0005 is outside .* 0\.2 \.\.\. 0\.5"),
        ({"elastic": {"thickness_m": 15.0}}, "thickness_m = 15 .* mm"),
        ({"elastic": {"work_of_adhesion_J_m2": 30.0}}, "work_of_adhesion_J_m2 = 30 .* mJ"),
        ({"tolerance": {"relative": 5.0}}, r"\[tolerance\] relative = 5 .* was it given in per cent"),
        ({"tolerance": {"relative": 1.0}}, r"\[tolerance\] relative = 1 .* was it given in per cent"),
        (
            {"elastic": {"young_modulus_std_Pa": 0.02}},
            r"young_modulus_std_Pa over 3e\+06 = 6.67e-09 .* relative",
        ),
        (
            {"elastic": {"young_modulus_std_Pa": 1e8}},
            r"young_modulus_std_Pa over 3e\+06 = 33.3 .* another unit",
        ),
        ({"load": {"zero_std_N": 1.0}}, r"zero_std_N over 0\.05 = 20 .* another unit"),
        ({"indenter": {"radius_m": 128.8}}, "radius_m = 129 .* was it given in mm"),
        ({"indenter": {"apex_m": [1.0, 1.0]}}, r"apex_m \(1, 1\) from the asperities .* was it given in mm"),
        ({"indenter": {"apex_m": [1000.0, 1000.0]}}, r"apex_m .* was it given in µm"),
        (
            {"camera": {"centre_m": [-0.01, 0.001]}},
            r"centre_m \(-0.01, 0.001\) from the asperities .* another sign",
        ),
        ({"camera": {"pixel_size_m": 6.0}}, "pixel_size_m = 6 .* in µm"),
        ({"camera": {"pixel_size_m": 0.006}}, "pixel_size_m = 0.006 "),
        ({"simulate": {"loads_N": [5.0, 20.0, 50.0]}}, "diagonal of the sample .* mN or grams"),
        ({"indenter": {"radius_m": 0.0001}}, "over its radius .* 0.5; is the load in mN"),
    ],
)
def test_a_slip_in_a_scene_is_named_with_its_likely_unit(asperities, sections, said):
    with pytest.raises(InputError, match=f"scene.toml: .*{said}.*--no-plausibility"):
        settle(doubts_about_scene(changed(**sections), asperities), "scene.toml")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda t: t.rename(columns={"height_m": "radius_m", "radius_m": "height_m"}),
            "are columns swapped",
        ),
        (lambda t: t.rename(columns={"height_m": "x_m", "x_m": "height_m"}), "are columns swapped"),
        (lambda t: t.assign(radius_m=1e3 * t["radius_m"]), "median of radius_m .* mm"),
        (
            lambda t: t.assign(radius_m=t["radius_m"].where(t.index != 4, 1e3 * t["radius_m"])),
            r"radius_m of asperity 4 over the median = 1e\+03 .* another unit than the others",
        ),
        (
            lambda t: t.assign(y_m=t["y_m"].where(t.index != 7, 1e3 * t["y_m"])),
            "distance of asperity 7 from the median .* is its x_m or y_m in another unit",
        ),
        (
            lambda t: t.assign(height_m=t["height_m"].where(t.index != 7, 1e3 * t["height_m"])),
            "distance of asperity 7 from the median .* is its height_m in another unit",
        ),
        (lambda t: t.assign(x_m=1e3 * t["x_m"]), "longer side .* are x_m and y_m in different units"),
        (lambda t: t.assign(x_m=1e-3 * t["x_m"], y_m=1e-3 * t["y_m"]), "are x_m, y_m and radius_m in metres"),
        (lambda t: t.assign(height_m=1e3 * t["height_m"].abs()), "height_m over radius_m .* different units"),
        (lambda t: t.assign(height_m=-t["height_m"].abs()), "height_m over radius_m .* wrong sign"),
        (lambda t: t.assign(y_m=-t["y_m"]), "from the asperities .* another sign"),
        (lambda t: t.assign(x_m=1e3 * t["x_m"], y_m=1e3 * t["y_m"]), "over their distance .* in metres"),
        (
            lambda t: pd.concat([t, t[:1] + 1e-7]),
            "distance of the asperities 0 and .* is one of them there twice",
        ),
    ],
)
def test_a_slip_in_the_asperity_table_is_named(asperities, change, said):
    table = change(asperities)
    with pytest.raises(InputError, match=said):
        settle(doubts_about_scene(changed(), table, [0.05]), "scene.toml")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((3.0, 0.03, 0.01, 0.01), "fitted young_modulus = 3 .* loads in N"),
        ((3e6, 40.0, 0.01, 0.01), "fitted work_of_adhesion = 40 .* loads in N"),
        ((3e6, 0.03, 0.01, 0.3), "scatter of the loads .* = 0.3 .* in their order"),
        ((3e6, 0.03, 1.3, 0.01), "largest contact radius over that of the sphere = 1.3"),
    ],
)
def test_a_slip_in_the_result_of_a_calibration(values, said):
    names = ("young_modulus", "work_of_adhesion", "contact_over_radius", "scatter")
    doubts = doubts_about_calibration(**dict(zip(names, values, strict=True)))
    with pytest.raises(InputError, match=said):
        settle(doubts, "the calibration")
    sound = dict(zip(names, (3e6, -0.01, 0.1, 0.05), strict=True))
    assert not list(doubts_about_calibration(**sound))


@pytest.mark.parametrize("slope", [1e-3, 0.1, 10.0, 100.0])
def test_forces_far_from_the_load_are_doubted(slope):
    with pytest.raises(InputError, match=f"forces over the load, .* = {slope:.3g} .* are loads in N"):
        settle(doubts_about_forces(slope=slope, young_modulus=3e6), "the calibration")
    assert not list(doubts_about_forces(slope=0.2, young_modulus=3e6))


@pytest.mark.parametrize(("kind", "factor"), [("modulus", 1e3), ("threshold", 1e-3)])
def test_loads_in_another_unit_are_refused_by_the_calibrations(kind, factor, small_series, tmp_path, capfd):
    folder = copy_of(small_series, tmp_path / "series")
    table = pd.read_csv(folder / "loads.csv")[-1:]
    (folder / "frame_1.tif").unlink()
    (folder / "frame_2.tif").unlink()
    table.assign(load_N=factor * table["load_N"]).to_csv(folder / "loads.csv", index=False)
    words = ["calibrate", kind, str(folder), "-o", str(tmp_path / "out"), "--workers", "1", "--quiet"]
    assert main([*words, *(["--threshold", "0.5"] if kind == "modulus" else [])]) == 2
    said = capfd.readouterr().err
    assert "is outside the plausible range" in said
    assert not (tmp_path / "out" / "calibration.json").exists()


def test_exchanged_columns_of_the_asperities_are_found_by_the_pose(small_series, tmp_path, capfd):
    folder = copy_of(small_series, tmp_path / "series")
    table = read_asperities(folder / "asperities.csv")
    names = {"x_m": "y_m", "y_m": "x_m"}
    table.rename(columns=names)[list(table)].to_csv(folder / "asperities.csv", index=False)
    words = [
        "process",
        str(folder),
        "-o",
        str(tmp_path / "out"),
        "--workers",
        "1",
        "--quiet",
        "--no-pictures",
    ]
    assert main([*words, "--method", "threshold"]) == 0
    said = capfd.readouterr().err
    assert "are x_m and y_m of the asperities exchanged?" in said


def test_doubts_can_be_warnings(caplog):
    with doubts_as_warnings():
        settle(["x is odd", "y is odd"], "a.toml")
    assert caplog.messages == ["a.toml: x is odd", "a.toml: y is odd"]
    with pytest.raises(InputError, match="and 1 more of this kind"):
        settle(["x is odd", "y is odd"], "a.toml")


def test_commands_refuse_a_slip_unless_told_not_to(tmp_path, capfd):
    (tmp_path / "scene.toml").write_text(
        "[indenter]\nradius_m = 0.1\n[elastic]\nyoung_modulus_Pa = 3.0\n"
        "[asperities]\ngenerate = 'SA'\ncoverage = 0.4\nside_m = 0.0005\n"
    )
    for command in (["predict", "--load-N", "1e-9"], ["simulate"], ["effects"], ["tradeoff"]):
        assert main([command[0], str(tmp_path), *command[1:]]) == 2
        assert "was it given in kPa or MPa or GPa" in capfd.readouterr().err
    assert main(["predict", str(tmp_path), "--load-N", "1e-9", "--no-plausibility", "--quiet"]) == 0
    assert "young_modulus_Pa = 3 is outside" in capfd.readouterr().err
