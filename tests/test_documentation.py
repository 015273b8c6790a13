"""The documentation leads where it says: relative links, file names and headings; the README stays short."""

import re
from pathlib import Path

import pytest
from smaller_frames import crop, widen_pixels

ROOT = Path(__file__).parents[1]
GENERATED = {ROOT / "docs" / name for name in ("_build", "gallery", "reference/generated")}
PAGES = [
    path
    for pattern in ("*.md", "docs/**/*.md", "notebooks/**/*.md", "sample_data/**/*.md", "tests/data/*.md")
    for path in sorted(ROOT.glob(pattern))
    if not GENERATED & set(path.parents)
]
NAMES = [path.relative_to(ROOT).as_posix() for path in PAGES]


@pytest.mark.parametrize("path", PAGES, ids=NAMES)
def test_relative_links_lead_to_files(path):
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\((?!\w+:|#)([^)#\s]+)", text):
        target = (path.parent / link).resolve()
        assert target.exists() or GENERATED & set(target.parents), f"{path.name} links to {link}"


@pytest.mark.parametrize("path", PAGES, ids=NAMES)
def test_modules_and_scripts_that_are_named_exist(path):
    """A name with a folder is a path from the root or in the package."""
    for name in re.findall(r"[`\s(]([\w./]+/\w+\.py)\b", path.read_text(encoding="utf-8")):
        assert (ROOT / name).exists() or (ROOT / "contactimg" / name).exists(), f"{path.name} names {name}"


def test_the_readme_is_short_and_has_two_set_up_commands():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 120
    set_up = readme.split("## Set up")[1].split("\n## ")[0]
    assert [block.count("\n") for block in re.findall(r"```bash\n(.*?)```", set_up, re.DOTALL)] == [1, 1]


@pytest.mark.slow
def test_the_commands_that_pages_show_run_and_print_what_is_shown(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import documented_commands

    prepare = documented_commands.prepare

    def prepare_less(folder):
        """Of frames from which no page shows numbers, a quarter of the pixels."""
        prepare(folder)
        widen_pixels(folder / "sample_data" / "smooth_jkr")
        for name in ("my_frames", "sample_data/ra_plus", "sample_data/sa_plus_places"):
            crop(folder / name)

    monkeypatch.setattr(documented_commands, "prepare", prepare_less)
    less = {"contactimg calibrate threshold": " --frames frame_2.tif"}
    monkeypatch.setattr(documented_commands, "SHORTENED", documented_commands.SHORTENED | less)
    wrong, done = documented_commands.run_pages()
    assert not wrong, "\n".join(wrong)
    assert len(done) > 30


def test_shown_output_is_compared_to_the_last_digit_but_not_in_times(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    from documented_commands import same, stale

    assert same(" a  1.25(12)  37  2.5 x  3 s", " a 1.26(13) 37 40 x 120 ms")
    for other in ("a 1.27(12) 37", "a 1.25(12) 38", "b 1.25(12) 37"):
        assert not same("a 1.25(12) 37", other)
    assert stale(["a", "...", "c"], ["a", "b", "b", "c"]) == []
    assert stale(["a", "b"], ["a"]) == ["- b"]
