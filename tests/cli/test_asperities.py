"""`asperities`: a map of a profilometer becomes a table that the other commands read."""

import json

import numpy as np
import pytest
import tifffile

from contactimg.cli import main
from contactimg.files import read_asperities, read_height_map, read_table
from contactimg.tables import SUMMITS

PIXEL_UM = 1.5
CAPS = [(-60.0, -45.0, 8.0, 80.0), (45.0, -30.0, 6.0, 60.0), (10.0, 50.0, 7.0, 100.0)]  # x, y, h, R in um
SCALE = ["--pixel-size-um", "1", "--height-unit", "um"]
SMALL = "1 2 3 4 5\n" * 20


@pytest.fixture(scope="module")
def heights():
    """Heights in um, with noise."""
    x, y = (np.arange(120) - 59.5) * PIXEL_UM, (np.arange(100) - 49.5) * PIXEL_UM
    out = np.random.default_rng(5).normal(0, 0.02, (100, 120))
    for cx, cy, height, radius in CAPS:
        squared = (x[None, :] - cx) ** 2 + (y[:, None] - cy) ** 2
        out += np.maximum(np.sqrt(np.maximum(radius**2 - squared, 0)) - radius + height, 0)
    out[3, 4] = np.nan
    return out


def written(folder, heights, kind):
    path = folder / f"map.{kind}"
    if kind == "npy":
        np.save(path, heights)
    elif kind == "tif":
        tifffile.imwrite(path, heights.astype(np.float32))
    elif kind == "csv":  # with a decimal comma and an empty cell for the hole
        lines = (
            ";".join("" if np.isnan(z) else f"{z:.4f}".replace(".", ",") for z in row) for row in heights
        )
        path.write_text("# heights in um\n" + "\n".join(lines))
    else:
        np.savetxt(path, heights, fmt="%.4f")
    if kind == "asc":  # numbers with a decimal comma between spaces, in the encoding of Windows' "Unicode"
        path.write_text(path.read_text().replace(".", ","), encoding="utf-16")
    return path


@pytest.mark.parametrize("kind", ["npy", "tif", "csv", "txt", "asc"])
def test_a_plain_matrix_gives_the_table_that_other_commands_read(heights, tmp_path, kind):
    path = written(tmp_path, heights, kind)
    out = tmp_path / "out"
    command = [
        "asperities",
        str(path),
        "--pixel-size-um",
        str(PIXEL_UM),
        "--height-unit",
        "um",
        "-o",
        str(out),
    ]
    assert main(command) == 0
    table = read_table(out / "asperities.csv", SUMMITS, required=tuple(SUMMITS.columns)[:-1])
    assert len(table) == len(CAPS)
    for row, (x, y, height, radius) in zip(
        table.itertuples(), sorted(CAPS, key=lambda c: -c[2]), strict=True
    ):
        assert row.x_m == pytest.approx(x * 1e-6, abs=5 * row.x_std_m)
        assert row.y_m == pytest.approx(y * 1e-6, abs=5 * row.y_std_m)
        assert row.height_m == pytest.approx(height * 1e-6, abs=5 * row.height_std_m)
        assert row.radius_m == pytest.approx(radius * 1e-6, abs=5 * row.radius_std_m)
    np.testing.assert_array_equal(read_asperities(out / "asperities.csv")["radius_m"], table["radius_m"])
    assert table["radius_std_m"].notna().all()
    record = json.loads((out / "provenance.json").read_text())
    assert record["noise_m"] == pytest.approx(20e-9, rel=0.05)
    assert record["inputs"]


def test_a_map_of_pixels_that_are_no_squares_keeps_both_sides(heights, tmp_path):
    path, resolution = tmp_path / "map.tif", (1 / 0.5, 1 / 0.8)
    image = heights.astype(np.float32)
    tifffile.imwrite(path, image, imagej=True, resolution=resolution, metadata={"unit": "um"})
    assert read_height_map(path, pixel_size=None, height_unit=1e-6).pixel_size == pytest.approx((5e-7, 8e-7))
    assert read_height_map(path, pixel_size=1e-6, height_unit=1e-6).pixel_size == (1e-6, 1e-6)


def test_predict_reads_the_table(heights, tmp_path, capsys):
    path = written(tmp_path, heights, "npy")
    command = ["asperities", str(path), "--pixel-size-um", str(PIXEL_UM), "--height-unit", "um"]
    assert main([*command, "-o", str(tmp_path), "--quiet"]) == 2  # a folder with files that no run wrote
    assert main([*command, "-o", str(tmp_path / "surface"), "--quiet"]) == 0
    (tmp_path / "scene.toml").write_text(
        "[indenter]\nradius_m = 0.1288\n[elastic]\nyoung_modulus_Pa = 1.6e6\npoisson_ratio = 0.5\n"
        '[asperities]\nfile = "surface/asperities.csv"\n'
    )
    assert (
        main(["predict", str(tmp_path / "scene.toml"), "--load-N", "0.0002", "-o", str(tmp_path / "p")]) == 0
    )
    capsys.readouterr()


@pytest.mark.parametrize(
    ("scale", "said"),
    [(("1500", "um"), "was it given in µm"), (("1.5", "mm"), "height_m over radius_m"), (("1.5", "um"), "")],
)
def test_a_slip_of_a_unit_is_named_with_the_table(heights, tmp_path, capsys, scale, said):
    command = ["asperities", str(written(tmp_path, heights, "npy")), "--quiet", "-o", str(tmp_path / "out")]
    assert main([*command, "--pixel-size-um", scale[0], "--height-unit", scale[1]]) == bool(said)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "options", "sentence"),
    [
        (("map.txt", SMALL), ["--pixel-size-um", "1"], "unit of its heights; state it with --height-unit"),
        (("map.txt", SMALL), ["--height-unit", "um"], "pixel size; state it with --pixel-size-um"),
        (("map.txt", SMALL), SCALE, "at least 16 rows"),
        (("map.npy", "no numpy file"), [], "cannot be read as a height map"),
        (("map.sur", "no surface"), [], "cannot be read as a height map"),
        (("map.txt", "a b c\n" * 20), [], "cannot be read as a height map"),
        (
            ("map.txt", "nrows 30\n" + SMALL * 2),
            SCALE,
            "Line #2 (got 5 columns instead of 2); begin lines that",
        ),
        (("map.txt", "# from the profilometer\n"), [], "as a height map (it holds no number)"),
        (("map.txt", "PK\3\4\0\0"), [], "map.txt: is an Excel workbook or another zip file, not text"),
        (("map.txt", "1, 2, 3, 4\n" * 20), SCALE, "rows and columns, got the shape (20, 4)"),
        (("map.txt", "1,5 2 3 4,5\n" * 20), SCALE, "rows and columns, got the shape (20, 4)"),
        (("map.txt", "1,5;2;3;4,5;\n" * 20), SCALE, "rows and columns, got the shape (20, 4)"),
        (("map.txt", "1,2,3,4\n" * 20), SCALE, "rows and columns, got the shape (20, 4)"),
        (("map.txt", (" ".join(["0"] * 30) + "\n") * 30), SCALE, "no summit found"),
    ],
)
def test_what_is_no_map_is_refused_in_one_sentence(tmp_path, capsys, file, options, sentence):
    name, content = file
    (tmp_path / name).write_text(content)
    assert main(["asperities", str(tmp_path / name), *options, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_file_of_another_shape_is_named_once(tmp_path, capsys):
    path = tmp_path / "stack.npy"
    np.save(path, np.zeros((3, 20, 20)))
    assert main(["asperities", str(path), *SCALE, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "must hold one matrix of numbers" in error
    assert error.count(str(path)) == 1
