"""`process` with several folders: each as if alone, one table of all, and one bad folder stops no other."""

import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main

TABLES = ("contacts.csv", "frames.csv", "rejected.csv")


@pytest.fixture(scope="module")
def folders(small_series, tmp_path_factory):
    """Two copies of the small series, and one without frames."""
    top = tmp_path_factory.mktemp("several")
    for name in ("dry", "wet"):
        copy_of(small_series, top / name)
    for frame in sorted((top / "wet").glob("frame_*.tif"))[1:]:
        frame.unlink()
    (top / "empty").mkdir()
    return top


@pytest.fixture(scope="module")
def results(folders):
    """Output of `process` for all of them, and its exit code."""
    words = ["process", *(str(folders / name) for name in ("dry", "empty", "wet"))]
    return folders / "out", main([*words, "-o", str(folders / "out"), "--no-pictures", "--quiet"])


@pytest.mark.parametrize("name", ["dry", "wet"])
def test_each_folder_is_measured_as_if_alone(folders, results, name, tmp_path):
    words = ["process", str(folders / name), "-o", str(tmp_path / "alone"), "--no-pictures", "--quiet"]
    assert main(words) == 0
    for table in TABLES:
        assert (tmp_path / "alone" / table).read_bytes() == (results[0] / name / table).read_bytes()


def test_the_joined_tables_have_every_row_with_the_name_of_its_folder(results):
    out, code = results
    assert code == 1  # a folder was left out
    for table in ("contacts", "frames"):
        joined = pd.read_csv(out / "combined" / f"all_{table}.csv")
        assert joined.columns[0] == "run"
        for name, rows in joined.groupby("run"):
            alone = pd.read_csv(out / name / f"{table}.csv")
            pd.testing.assert_frame_equal(
                rows.drop(columns="run").reset_index(drop=True), alone, check_dtype=False
            )
        assert set(joined["run"]) == {"dry", "wet"}


def test_what_cannot_be_told_apart_or_placed_is_refused(folders, tmp_path, capsys):
    one = str(folders / "dry")
    assert main(["process", one, str(folders / "wet")]) == 2
    assert "-o OUT" in capsys.readouterr().err
    assert (
        main(["process", one, str(copy_of(folders / "dry", tmp_path / "dry")), "-o", str(tmp_path / "out")])
        == 2
    )
    assert "two folders are called dry" in capsys.readouterr().err
    assert main(["process", str(folders / "empty"), str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "none of the folders" in capsys.readouterr().err
