"""The guides at the head of the packages ("Read in this order ...") name modules that exist."""

import pkgutil
import re
from importlib import import_module
from pathlib import Path

import pytest

import contactimg

PACKAGES = [
    package.name
    for package in pkgutil.walk_packages(contactimg.__path__, "contactimg.")
    if package.ispkg and "web" not in package.name
]


@pytest.mark.parametrize("name", PACKAGES)
def test_a_guide_names_modules_that_exist(name):
    package = import_module(name)
    folder = Path(package.__file__).parent
    inside = {path.stem for path in folder.glob("*.py")} | {path.name for path in folder.iterdir()}
    guide = re.search(r"Read .*", package.__doc__ or "", re.DOTALL)
    for word in re.findall(r"`+([a-z_]+)(?:\.\w+)?`+", guide[0] if guide else ""):
        assert word in inside or hasattr(package, word), f"{name} names {word}"
