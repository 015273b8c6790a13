"""`design` from the command line: what it writes, what `predict` makes of it, what it says no to."""

import json

import numpy as np
import pytest

from contactimg import InputError, scene_from_dict
from contactimg.cli import main
from contactimg.files import read_asperities, read_scene, read_table
from contactimg.plots import plot_design
from contactimg.tables import DESIGNED, FRAMES

SURFACE = ["--cap-radius-um", "500", "--spacing-mm", "1", "--young-modulus-MPa", "1.36", "--quiet"]


@pytest.fixture
def friction_table(tmp_path):
    path = tmp_path / "friction.csv"
    path.write_text("load_mN,friction_N\n40,0.048\n100,0.12\n200,0.255\n", encoding="utf-8")
    return path


def test_predict_finds_the_law_on_the_designed_surface(tmp_path, friction_table, monkeypatch):
    monkeypatch.setattr("contactimg.design.surface.LOADS", 9)  # `test_design.py` takes all
    out, predicted = tmp_path / "designed", tmp_path / "predicted"
    strength = ["--shear-strength-MPa", "0.3", "--tolerance", "0.02"]
    assert main(["design", "--law", str(friction_table), *strength, *SURFACE, "-o", str(out)]) == 0
    written = {"asperities.csv", "law.csv", "law.svg", "scene.toml", "provenance.json"}
    assert {path.name for path in out.iterdir()} == written
    assert len(read_asperities(out / "asperities.csv")) == 64
    assert read_scene(out).indenter.radius == np.inf
    record = json.loads((out / "provenance.json").read_text(encoding="utf-8"))
    assert "friction.csv" in json.dumps(record["inputs"])

    loads = ["0.04", "0.07", "0.1", "0.15", "0.2"]
    options = [word for load in loads for word in ("--load-N", load)]
    assert main(["predict", str(out), *options, "-o", str(predicted), "--quiet"]) == 0
    frames = read_table(predicted / "frames.csv", FRAMES)
    friction = np.interp([float(load) for load in loads], [0.04, 0.1, 0.2], [0.048, 0.12, 0.255])
    np.testing.assert_allclose(0.3e6 * frames["area_m2"], friction, rtol=0.03)

    law = read_table(out / "law.csv", DESIGNED)
    assert law["load_N"].iloc[[0, -1]].tolist() == pytest.approx([0.04, 0.2])
    ax = plot_design(law)
    labels = [line.get_label() for line in ax.lines]
    assert labels[0] == "wanted"
    assert any(label.startswith("designed for coupled") for label in labels)
    top, below = ax.get_figure().axes
    assert (top.get_ylabel(), below.get_xlabel()) == ("real contact area A (mm²)", "load P (mN)")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--law", "A = 5e-6 P"], "needs --max-load-N"),
        (["--law", "area = P", "--max-load-N", "1"], "the law 'area = P' is not understood"),
        (["--law", "F = 1 P", "--max-load-N", "1"], "needs the shear strength"),
        (["--law", "A = 5e-6 P", "--max-load-N", "9"], "the law is not possible: the law needs"),
        (["--law", "none.csv"], "none.csv: cannot be read"),
        (["--law", "friction.csv"], "needs the shear strength"),
        (
            ["--law", "friction.csv", "--max-load-N", "3", "--shear-strength-MPa", "1"],
            "are not a range inside",
        ),
        (["--law", "A = 5e-6 P", "--max-load-N", "-1"], "not in the range x>0"),
        (["--max-load-N", "1"], "Missing option '--law'"),
    ],
)
@pytest.mark.usefixtures("friction_table")
def test_what_is_not_possible_is_one_sentence(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    assert main(["design", *words, *SURFACE]) == 2
    assert said in (error := capsys.readouterr().err)
    assert "Traceback" not in error
    assert {path.name for path in tmp_path.iterdir()} == {"friction.csv"}


def test_a_table_may_be_in_other_units_and_its_faults_name_it(tmp_path, capsys):
    path = tmp_path / "law.csv"
    words = ["design", "--law", str(path), *SURFACE, "-o", str(tmp_path / "out")]
    path.write_text("load_mN;area_mm2\n10;0,05\n300;1,5\n", encoding="utf-8")
    assert main([*words, "--tolerance", "0.9"]) == 0
    assert read_table(tmp_path / "out" / "law.csv", DESIGNED)["wanted_area_m2"].iloc[-1] == pytest.approx(
        1.5e-6
    )
    path.write_text("load_N,area_m2\n0.3,1.5e-6\n0.1,6e-7\n", encoding="utf-8")
    assert main(words) == 2
    assert "law.csv: a law needs two points or more with increasing load_N" in capsys.readouterr().err


def test_constants_come_from_a_scene_or_options(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text("[indenter]\nradius_m = 0.1\n", encoding="utf-8")
    words = ["--law", "A = 5e-6 P", "--max-load-N", "1", *SURFACE[:4]]
    assert main(["design", str(tmp_path), *words]) == 2
    assert "(or --young-modulus-MPa) needs a section [elastic]" in capsys.readouterr().err


def test_an_indenter_may_be_flat(tmp_path, capsys):
    flat = scene_from_dict({"indenter": {"radius_m": "flat"}})
    assert flat.indenter.radius == np.inf
    assert flat.configuration["indenter"]["radius_m"] == "flat"
    for wrong in (float("nan"), -1.0, "round"):
        with pytest.raises(InputError, match="radius_m must be"):
            scene_from_dict({"indenter": {"radius_m": wrong}})
    (tmp_path / "asperities.csv").write_text(
        "x_m,y_m,height_m,radius_m\n0,0,4e-5,1e-4\n1e-3,0,3e-5,1e-4\n", encoding="utf-8"
    )
    (tmp_path / "scene.toml").write_text(
        '[indenter]\nradius_m = "flat"\n[elastic]\nyoung_modulus_Pa = 3e6\n'
        '[asperities]\nfile = "asperities.csv"\n',
        encoding="utf-8",
    )
    for model in ("gw", "gt"):
        assert main(["predict", str(tmp_path), "--load-N", "1e-3", "--model", model]) == 2
        assert f'model "{model}" takes a lens of finite radius' in capsys.readouterr().err
    assert main(["predict", str(tmp_path), "--load-N", "1e-3", "-o", str(tmp_path / "out"), "--quiet"]) == 0
