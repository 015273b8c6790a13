"""Runs to review."""

from small_series import copy_of

from contactimg.cli import main


def process(series, target):
    """Measure a series with the command."""
    options = ["--quiet", "--no-pictures", "--workers", "1"]
    assert main(["process", str(series), "-o", str(target), *options]) == 0
    return target


def moved(folder, target):
    """A copy of a folder with series and run; the run then was made from the copied series."""
    copy = copy_of(folder, target)
    record = copy / "run" / "provenance.json"
    text = record.read_text(encoding="utf-8")
    record.write_text(text.replace(str(folder), str(copy)), encoding="utf-8")
    return copy
