"""Every command reads the run folder of a version that wrote fewer columns (``tests/data/older_run``)."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import read_run
from contactimg.tables import CONTACTS, FRAMES

STORED = Path(__file__).parents[1] / "data" / "older_run"


@pytest.fixture
def run(tmp_path):
    return Path(shutil.copytree(STORED, tmp_path / "frames")) / "run"


def test_columns_that_were_added_later_are_empty(run):
    stored = pd.read_csv(run / "contacts.csv")
    found = read_run(run)
    assert not set(stored.columns) & CONTACTS.later.keys()
    for table, schema in ((found.contacts, CONTACTS), (found.frames, FRAMES)):
        assert list(table.columns) == list(schema.columns)
        for name in schema.later:
            assert (table[name] == "").all() if schema.columns[name][0] == "str" else table[name].isna().all()
    np.testing.assert_array_equal(found.contacts["radius_m"], stored["radius_m"])
    assert found.changed == ()


@pytest.mark.parametrize(
    "words",
    [("analyse", "{run}", "-o", "{out}", "--no-models"),
     ("overlay", "{run}", "-o", "{out}", "--workers", "1"),
     ("report", "{run}", "-o", "{out}.html"), ("export", "{run}", "-o", "{out}")],
    ids=lambda words: words[0],
)  # fmt: skip
def test_commands_read_it(run, tmp_path, words, capfd):
    out = tmp_path / "out"
    assert main([word.format(run=run, out=out) for word in words]) == 0, capfd.readouterr().err


def test_a_column_that_was_always_there_is_missed(run):
    table = pd.read_csv(run / "contacts.csv").drop(columns="radius_m")
    table.to_csv(run / "contacts.csv", index=False)
    with pytest.raises(InputError, match=r"contacts\.csv: column radius_m is missing"):
        read_run(run)
