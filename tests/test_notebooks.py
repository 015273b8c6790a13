"""Every notebook runs from top to bottom, defines nothing, and its stored full results belong to it."""

import ast
import importlib
import re
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pandas as pd
import pytest
from smaller_frames import crop

import contactimg

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "notebooks" / "results"
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
WITH_RESULTS = [path for path in NOTEBOOKS if "CONTACTIMG_FULL" in path.read_text(encoding="utf-8")]

LEFT_OUT = {
    "01_one_frame": ["sa_plus/frame_[56].tif"],
    "05_overlay": [],
    "06_calibration": [
        "smooth_jkr/frame_0[2346789].tif",
        "smooth_jkr/frame_10.tif",
        "sa_plus/frame_[235].tif",
        "ra_plus/frame_[245].tif",
    ],
    "07_friction": ["ra_plus/frame_[245].tif"],
    "11_annulus": [],
}
"""Frames of the sample data that a notebook does not need to run; it has the middle of the others."""

SMALLER = {
    "03_pressure_profiles": {
        "(20, 1)": "(3, 1)",
        " 6e-6": " 12e-6",
        "=6e-6": "=12e-6",
        "[1200, 1600]": "[600, 800]",
        "[1200, 1200]": "[600, 600]",
    },
    "04_density_and_radius": {"(60, 3)": "(32, 2)", "0.5, 60)": "0.5, 20)"},
    "06_calibration": {
        "0.9, 33)": "0.9, 9)",
        "0.95, 37)": "0.95, 10)",
        "[0.05, 0.3])": "[0.02, 0.05])",
        '"loads_N": loads,': '"loads_N": loads, "shape": [240, 250],',
    },
    "07_friction": {"[560, 560]": "[400, 400]", "0.95, 37)": "0.95, 10)"},
    "09_crossover_pressure": {"(25, 3)": "(5, 3)", "rings=800": "rings=200"},
    "11_annulus": {"(6, 3)": "(2, 3)"},
    "13_contacts_under_shear": {
        "6e-6, 2.4e-3": "6e-6, 2.0e-3",
        "[400, 420]": "[340, 350]",
        "0.006, 0.009, 0.012, 0.014, 0.016, 0.018, 0.02]": "0.009, 0.014, 0.018, 0.02]",
    },
    "14_designed_surfaces": {"loads(20)": "loads(5)"},
}
"""Numbers of a notebook, and smaller ones with which it runs as well: what it finds is not asserted."""

# what a number of ours is, and what the number of the paper is beside which it stands
OURS = {"simulated", "rendered", "circular"}
PAPER = {"measured", "simulated", "stated"}

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
every_result = pytest.mark.parametrize("path", WITH_RESULTS, ids=lambda path: path.stem)


def code_of(path):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


def smaller_code_of(path):
    """The source of the code cells, with smaller numbers."""
    text = "\0".join(cell.source for cell in code_of(path))
    for stated, smaller in SMALLER.get(path.stem, {}).items():
        assert stated in text
        text = text.replace(stated, smaller)
    return text.split("\0")


def tree_of(path):
    return ast.parse("\n".join(cell.source for cell in code_of(path)))


def stored_bytes():
    return {path.name: path.read_bytes() for path in RESULTS.iterdir()}


def with_smaller_frames(top, left_out):
    """A folder for a notebook, beside a copy of the sample data with fewer and smaller frames."""

    def ignore(folder, names):
        return [name for name in names if any(Path(folder, name).match(pattern) for pattern in left_out)]

    shutil.copytree(ROOT / "sample_data", top / "sample_data", ignore=ignore)
    for name in ("sa_plus", "sa_plus_places", "ra_plus"):
        crop(top / "sample_data" / name)
    (top / "notebooks").mkdir()
    (top / "notebooks" / "results").symlink_to(RESULTS)
    return top / "notebooks"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@every_notebook
def test_notebook_runs(path, tmp_path, monkeypatch):
    """With its small ensembles; that its rows are those of the stored table, the notebook itself asserts."""
    monkeypatch.delenv("CONTACTIMG_FULL", raising=False)
    monkeypatch.setattr("contactimg.design.surface.LOADS", 9)  # `tests/design` takes all
    left_out = LEFT_OUT.get(path.stem)
    monkeypatch.chdir(path.parent if left_out is None else with_smaller_frames(tmp_path, left_out))
    before, names = stored_bytes(), {"display": lambda *_: None}
    with np.errstate(all="ignore"):
        for source in smaller_code_of(path):
            exec(compile(source, path.name, "exec"), names)  # noqa: S102 - as its kernel does
    plt.close("all")
    assert stored_bytes() == before


@every_notebook
def test_notebook_is_stored_as_it_ran_and_defines_no_function(path):
    cells = [cell for cell in code_of(path) if cell.source]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds_of_output = {output.output_type for cell in cells for output in cell.outputs}
    assert "error" not in kinds_of_output
    assert kinds_of_output & {"display_data", "execute_result", "stream"}
    assert path.stat().st_size < 400_000
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef
    assert not [node for node in ast.walk(tree_of(path)) if isinstance(node, kinds)]


@every_notebook
def test_notebook_uses_the_public_names_only(path):
    public = {*contactimg.__all__, "plots"}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            assert not any(alias.name.startswith("contactimg.") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module.startswith("contactimg"):
            assert node.module == "contactimg"
            assert {alias.name for alias in node.names} <= public
        elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "contactimg":
            assert node.attr in public


def test_notebooks_with_ensembles_are_found():
    assert len(WITH_RESULTS) == 10


@every_result
def test_stored_results_hold_what_the_notebook_shows(path):
    table = pd.read_csv(RESULTS / f"{path.stem}.csv")
    assert list(table.columns) == ["quantity", "ours", "std", "ours_is", "paper", "paper_is", "note"]
    assert set(table["ours_is"]) <= OURS
    assert set(table["paper_is"].dropna()) <= PAPER
    assert (table["paper"].isna() == table["paper_is"].isna()).all()
    assert np.isfinite(table["ours"]).all()
    assert table["paper"].notna().any()
    text = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells)
    assert "10.1039/C4SM02346C" in text
    assert all(f"**{kind}" in text for kind in set(table["ours_is"]))  # and says so at the start
    named = re.findall(r"results/([\w.]+\.(?:csv|png))", text)
    assert f"{path.stem}.csv" in named
    assert any(name.endswith(".png") for name in named)
    for name in named:
        assert 0 < (RESULTS / name).stat().st_size < 400_000  # a repository is no store of pictures


def test_nothing_is_stored_that_no_notebook_names():
    text = "".join(path.read_text(encoding="utf-8") for path in NOTEBOOKS)
    stored = {path.name for path in RESULTS.iterdir()} - {"README.md", "runs.csv"}
    assert {name for name in stored if name not in text} == set()


def test_listed_tables_are_the_stored_ones(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    script = importlib.import_module("notebook_results")
    assert [path.stem for path in script.with_results()] == [path.stem for path in WITH_RESULTS]
    listed = set(pd.read_csv(RESULTS / "runs.csv")["notebook"])
    assert listed == {path.stem for path in WITH_RESULTS}
    assert (RESULTS / "README.md").read_text(encoding="utf-8") == script.page()
    assert (ROOT / "docs" / "models.md").read_text(encoding="utf-8") == script.models_page()
