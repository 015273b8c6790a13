"""Tables of a run as Parquet: written and read like those in CSV."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import TableWriter, encoded_rows, read_run, read_run_table, tables
from contactimg.tables import CONTACTS

pytest.importorskip("pyarrow")
STORED = Path(__file__).parents[1] / "data" / "older_run"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same frames processed into both formats."""
    top = tmp_path_factory.mktemp("formats")
    shutil.copytree(STORED, top / "frames", ignore=shutil.ignore_patterns("run"))
    for name in ("csv", "parquet"):
        words = ["process", str(top / "frames"), "-o", str(top / name), "--format", name, "--workers", "1"]
        assert main([*words, "--quiet", "--no-pictures"]) == 0
    return top


def test_both_formats_hold_the_same(runs):
    names = {path.name for path in (runs / "parquet").iterdir()}
    assert names == {"contacts.parquet", "frames.parquet", "rejected.parquet", "provenance.json"}
    one, two = read_run(runs / "csv"), read_run(runs / "parquet")
    pd.testing.assert_frame_equal(one.contacts, two.contacts, check_exact=True)
    pd.testing.assert_frame_equal(one.frames, two.frames, check_exact=True)
    assert len(one.contacts) > 5
    assert two.changed == ()


@pytest.mark.usefixtures("figures_stay_unwritten")
@pytest.mark.parametrize("command", ["analyse", "overlay", "export"])
def test_commands_give_the_same_from_both(runs, tmp_path, command):
    found, fewer = [], ["--no-models"] if command == "analyse" else []
    for name in ("csv", "parquet"):
        out = tmp_path / name
        assert main([command, str(runs / name), "-o", str(out), "--quiet", *fewer]) == 0
        found.append({p.relative_to(out): p.read_bytes() for p in out.rglob("*.csv")})
    assert found[0] == found[1]
    assert found[0] or command == "export"


def test_another_format_replaces_the_earlier_run(runs, tmp_path):
    out = shutil.copytree(runs / "parquet", tmp_path / "out")
    words = ["process", str(runs / "frames"), "-o", str(out), "--workers", "1", "--quiet", "--no-pictures"]
    assert main(words) == 0
    assert not list(out.glob("*.parquet"))
    assert (out / "contacts.csv").read_bytes() == (runs / "csv" / "contacts.csv").read_bytes()


def test_changed_table_is_noticed(runs, tmp_path):
    out = shutil.copytree(runs / "parquet", tmp_path / "out")
    contacts = read_run(out).contacts
    with TableWriter(CONTACTS, out, "parquet") as table:
        table.append(encoded_rows(contacts.iloc[1:], CONTACTS, "parquet"))
    run = read_run(out)
    assert run.changed == ("contacts.parquet",)
    assert run.frames["n_contacts"].sum() == len(contacts) - 1


@pytest.mark.parametrize("damage", [b"PAR1", b"\0" * 40])
def test_damaged_file_is_one_sentence(tmp_path, damage):
    CONTACTS.empty().to_parquet(tmp_path / "contacts.parquet")
    whole = (tmp_path / "contacts.parquet").read_bytes()
    # in place of all of it, or of what the footer says of the columns
    damaged = damage if damage == b"PAR1" else whole[:-200] + damage + whole[-200 + len(damage) :]
    (tmp_path / "contacts.parquet").write_bytes(damaged)
    with pytest.raises(InputError, match=r"contacts\.parquet: is not a Parquet file"):
        read_run_table(tmp_path, CONTACTS)
    pd.DataFrame({"frame": ["a"], "label": ["x"]}).to_parquet(tmp_path / "contacts.parquet")
    with pytest.raises(InputError, match=r"contacts\.parquet: column x_px is missing; repeat the run"):
        read_run_table(tmp_path, CONTACTS)


def test_without_pyarrow_the_command_says_so_before_any_work(runs, tmp_path, monkeypatch, capsys):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(tables.importlib, "import_module", missing)
    assert main(["process", str(runs / "frames"), "-o", str(tmp_path / "out"), "--format", "parquet"]) == 2
    assert "pip install pyarrow" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
