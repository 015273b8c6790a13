"""What the packages hold."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_source_distribution_holds_what_the_readme_shows_and_the_tests_read():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packed = set(settings["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    assert {name for name in packed if not (ROOT / name).exists()} == set()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"\]\((?!\w+:|#)([^)#]+)", readme)
    tests = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("*.py")]
    read = re.findall(r'(?:ROOT|parents\[1\]) / "([^"]+)"', "\n".join(tests))
    assert "docs/figures/overlay.png" in shown
    assert {"sample_data", "notebooks"} <= set(read)
    needed = {Path(name).parts[0] for name in shown + read} - {"pyproject.toml"}  # that one is always there
    assert needed <= packed
