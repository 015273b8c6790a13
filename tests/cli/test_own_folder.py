"""A folder of one's own, from the camera to the report, without a scene: each command as printed before."""

import json
import re
import shlex
import shutil

import pandas as pd
import small_series

from contactimg.cli import main

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0016, 0.0014]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.003, "seed": 4},
    "effects": {"model": "paper"},
    "simulate": small_series.SCENE["simulate"],
}

PREAMBLE = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nOperator\tMüller\n"
    "***End_of_Header***\t\n\nChannels\t2\nY_Unit_Label\tmN\tmN\n***End_of_Header***\t\n"
    "X_Value\tBild-Nr.\tKraft [mN]\tReibkraft [mN]\tKommentar\n"
)


def own_folder(target, **camera):
    """A folder as a camera and a LabVIEW program leave it, of a camera that stands as given."""
    scene = SCENE | {"camera": {"pixel_size_m": 6e-6, "centre_m": [0.00155, 0.0015], **camera}}
    loads = [0.01, 0.025, 0.06]
    made = small_series.write_small_series(
        target.with_name("made"), scene, loads_N=loads, shape=[380, 420], seed=8
    )
    folder = target / "Messung für Jörg, Nähe 2"
    folder.mkdir(parents=True)
    loads = pd.read_csv(made / "loads.csv")
    rows = ""
    for k, row in enumerate(loads.to_dict("records")):
        shutil.copy(made / row["frame"], folder / f"Img{123 + k:06d}.tif")
        rows += f"{0.5 * k:.3f}\t{123 + k}\t{1e3 * row['load_N']:.4f}\t0.0\t\n".replace(".", ",")
    shutil.copy(made / "reference.tif", folder / "ref.tif")
    shutil.copy(made / "asperities.csv", folder / "Höhen.csv")
    (folder / "Notizen.docx").write_bytes(b"PK")
    (folder / "Kraft.lvm").write_bytes((PREAMBLE + rows).encode("cp1252"))
    return folder


def test_from_the_folder_of_a_turned_camera_to_the_report(tmp_path, monkeypatch, capsys):
    folder = own_folder(tmp_path / "Eigene Daten", mirrored=True, rotation_deg=92.0)
    answers = iter(["6", "128,8", "3"])
    monkeypatch.setattr("click.termui.visible_prompt_func", lambda *_: next(answers))
    assert main(["init", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "loads from 'Kraft [mN]', friction from 'Reibkraft [mN]', frames from 'Bild-Nr.'" in said
    assert said.count("Notizen.docx") == 1

    for command in ("process", "overlay", "analyse", "report"):
        line = re.search(rf"^.*contactimg ({command} .+)$", said, re.MULTILINE)
        assert line, said
        assert main(shlex.split(line[1])) == 0
        said = capsys.readouterr().out

    out = folder / "contactimg_out"
    frames = pd.read_csv(out / "frames.csv")
    assert set(frames["status"]) == {"ok"}
    scores = pd.read_csv(out / "contactimg_out" / "scores.csv").query("model == 'coupled'")
    assert scores["n_matched"].sum() >= 0.98 * scores["n_measured"].sum()
    assert scores["n_matched"].sum() >= 0.98 * scores["n_predicted"].sum()
    results = pd.read_csv(out / "contactimg_out" / "results.csv").set_index(["quantity", "model"])
    for quantity in ("area_exponent", "density_exponent"):
        one, two = results.loc[(quantity, "measured")], results.loc[(quantity, "coupled")]
        assert abs(one["value"] - two["value"]) < (one["std"] ** 2 + two["std"] ** 2) ** 0.5
    apex = json.loads((out / "provenance.json").read_text())["apex"]
    assert apex["known"] == "found from the contacts"
    for place, std, true in zip(apex["apex_m"], apex["std_m"], (0.0016, 0.0014), strict=True):
        assert abs(place - true) < 3 * std < 20e-6
    assert (out / "report.html").is_file()
