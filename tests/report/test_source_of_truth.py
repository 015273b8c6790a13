"""Tables that were changed after a run, and results that were made from earlier tables, are noticed."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from contactimg import read_run
from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files.output import read_records
from contactimg.report import build_report


@pytest.fixture
def run(finished, tmp_path):
    """A copy of a run with an analysis in its folder and a comparison inside."""
    return shutil.copytree(finished, tmp_path / "run")


def visible_areas(contacts):
    """What the image shows of each contact."""
    return contacts["visible_area_m2"].fillna(contacts["area_m2"])


def test_untouched_results_are_all_on_the_page(run, caplog):
    page = build_report(run)
    assert 'id="predicted"' in page
    assert 'id="analysis"' in page
    assert not caplog.records


def test_results_of_an_earlier_measurement_are_left_out_by_name(run, finished):
    words = ["process", str(finished.parent / "series"), "-o", str(run), "--no-pictures", "--quiet"]
    assert main([*words, "--workers", "1", "--method", "threshold"]) == 1  # one frame fails
    page = build_report(run)
    assert 'id="predicted"' not in page
    assert 'id="analysis"' not in page
    assert page.count("repeat that command") == 2
    assert all(f"{place}: was made by" in page for place in (run, run / "contactimg_out"))
    words = ["analyse", str(run), "-o", str(run / "laws"), "--no-models", "--quiet"]
    assert main(words) == 0
    assert 'id="analysis"' in build_report(run)


def test_an_input_that_changed_after_the_run_is_named(run, tmp_path, caplog):
    records, table = read_records(run), tmp_path / "table.csv"
    record = next(one for one in records if "contacts.csv" in one["outputs"])
    shutil.copyfile(record["inputs"][-1]["path"], table)
    record["inputs"][-1]["path"] = str(table)
    (run / "provenance.json").write_text(json.dumps(record))
    read_run(run)  # of another time, but with the same content
    assert not caplog.records
    table.write_text(table.read_text() + "\n")
    read_run(run)
    assert f"{table} changed after the run; repeat it" in caplog.text


def test_sums_follow_a_contacts_table_that_was_changed(run, caplog):
    before = read_run(run)
    path = run / "contacts.csv"
    table = pd.read_csv(path)
    gone = table.index[table["frame"] == "frame_3.tif"][:3]
    table.drop(gone).to_csv(path, index=False)
    after = read_run(run)
    assert after.changed == ("contacts.csv",)
    assert "contacts.csv was changed after the run" in caplog.text
    old, new = (one.frames.set_index("frame") for one in (before, after))
    pd.testing.assert_frame_equal(old.drop("frame_3.tif"), new.drop("frame_3.tif"))
    old, new = old.loc["frame_3.tif"], new.loc["frame_3.tif"]
    left = after.contacts[after.contacts["frame"] == "frame_3.tif"]
    assert new["n_contacts"] == old["n_contacts"] - 3
    assert new["area_m2"] == pytest.approx(visible_areas(left).sum(), rel=1e-12)
    assert new["force_sum_N"] == pytest.approx(left["force_N"].sum(), rel=1e-12)
    assert new["area_std_m2"] / new["area_m2"] == pytest.approx(old["area_std_m2"] / old["area_m2"])
    page = build_report(run)
    assert "contacts.csv changed after the run" in page
    assert 'id="analysis"' not in page


def test_sums_that_were_edited_are_those_of_the_contacts_again(run):
    path = run / "frames.csv"
    table = pd.read_csv(path)
    table["area_m2"] *= 2
    table.to_csv(path, index=False)
    changed, contacts = read_run(run), pd.read_csv(run / "contacts.csv")
    assert changed.changed == ("frames.csv",)
    expected = visible_areas(contacts).groupby(contacts["frame"]).sum()
    found = changed.frames.set_index("frame")["area_m2"]
    np.testing.assert_allclose(found, expected.reindex(found.index), rtol=1e-12)  # NaN where the frame failed


def test_figures_are_those_that_the_analysis_wrote(run):
    (run / "area_of_somebody_else.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    assert "area_of_somebody_else" not in build_report(run)


def test_a_contact_without_a_place_among_others_is_named(run):
    path = run / "contacts.csv"
    table = pd.read_csv(path)
    table.loc[2, "x_m"] = np.nan
    table.to_csv(path, index=False)
    with pytest.raises(InputError, match=rf"contacts\.csv: row 3 of {len(table)} has no x_m and y_m"):
        read_run(run)
