"""A frame whose local forces do not balance its load is not ok."""

import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.files import read_scene, write_scene


def processed(folder, out, modulus, load_factor=1.0):
    """Frames table of the second frame, with another modulus or load than it was rendered with."""
    source = {name: dict(keys) for name, keys in read_scene(folder).source.items()}
    source["elastic"] |= {"young_modulus_Pa": modulus}
    write_scene(source, folder / "scene.toml")
    loads = pd.read_csv(folder / "loads.csv")
    loads.assign(load_N=load_factor * loads["load_N"]).to_csv(folder / "loads.csv", index=False)
    frame = loads["frame"][1]
    words = ["process", str(folder), "-o", str(out), "--no-pictures", "--quiet", "--frames", str(frame)]
    code = main(words)
    row = pd.read_csv(out / "frames.csv").iloc[0]
    assert code == (0 if row["status"] == "ok" else 1)  # the only frame has no forces to rely on
    return row


@pytest.mark.parametrize(
    ("modulus", "load_factor", "status"),
    [
        (3.0e6, 1.0, "ok"),
        (2.4e6, 1.0, "ok"),  # a modulus that is not calibrated
        (9.0e6, 1.0, "forces off load"),
        (3.0e6, 0.5, "forces off load"),
    ],
)
def test_the_balance_of_forces_decides_the_status(small_series, tmp_path, modulus, load_factor, status):
    row = processed(copy_of(small_series, tmp_path / "frames"), tmp_path / "out", modulus, load_factor)
    assert row["status"] == status
    ratio = row["force_sum_N"] / row["load_N"]
    said = f"add up to {ratio:.3g} times the load" in str(row["message"])
    assert said == (status != "ok")
