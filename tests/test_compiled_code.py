"""Machine code of compiled functions is that of the present sources, wherever the package lies."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

import contactimg
from contactimg import compiled
from contactimg.imaging.measure import measure_image

PACKAGE = Path(contactimg.__file__).parent

CALLER = """
from contactimg.compiled import njit
from contactimg.factor import FACTOR, scaled

@njit(cache=True)
def value(x):
    return scaled(x) + FACTOR
"""

CALLED = """
from contactimg.compiled import njit

FACTOR = {factor}

@njit(cache=True)
def scaled(x):
    return FACTOR * x
"""


@pytest.fixture
def package(tmp_path):
    """A package of this name with two modules: `value` calls `scaled` and reads a constant of the other."""
    folder = tmp_path / "installed" / "contactimg"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "unrelated.py").touch()
    (folder / "caller.py").write_text(CALLER)
    (folder / "factor.py").write_text(CALLED.format(factor=2.0))
    shutil.copy(PACKAGE / "compiled.py", folder)
    return folder


def run(package, code, **environment):
    """What the code prints in a process of its own."""
    usual = {name: text for name, text in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    given = {name: str(path) for name, path in environment.items()}
    done = subprocess.run(  # noqa: S603 - this package
        [sys.executable, "-B", "-c", code],
        env=usual | given | {"PYTHONPATH": str(package.parent)},
        capture_output=True,
        text=True,
        check=True,
        cwd=package.parent,
    )
    return done.stdout.strip()


VALUE = """
import numba
from contactimg.caller import value

print(value(3.0), sum(value.stats.cache_hits.values()), repr(numba.config.CACHE_DIR))
"""
"""The last is where numba stores the user's own functions: where the user says, or beside them."""


def test_a_change_of_what_a_function_calls_takes_effect_in_the_next_process(package, tmp_path):
    cache = tmp_path / "cache"
    unused_for_long_is_removed = left_by_earlier_runs(cache)
    assert run(package, VALUE, NUMBA_CACHE_DIR=cache) == f"8.0 0 {str(cache)!r}"
    unused_for_long_is_removed()
    (package / "unrelated.py").write_text("CHANGED = True\n")  # compiles nothing anew
    assert run(package, VALUE, NUMBA_CACHE_DIR=cache) == f"8.0 1 {str(cache)!r}"
    (package / "factor.py").write_text(CALLED.format(factor=5.0))
    assert run(package, VALUE, NUMBA_CACHE_DIR=cache) == f"20.0 0 {str(cache)!r}"


def left_by_earlier_runs(cache):
    """Leave code of other sources in the cache; what is returned asserts which of it a run has removed."""
    now = time.time()
    for name, age in (("old", 2 * compiled.UNUSED_SECONDS), ("used", 0.5 * compiled.UNUSED_SECONDS)):
        folder = cache / f"contactimg.caller-{name}"
        folder.mkdir(parents=True)
        os.utime(folder, (now - age, now - age))

    def check():
        kept = {path.name.partition("-")[2] for path in cache.glob("contactimg.caller-*")}
        assert len(kept) == 2
        assert "used" in kept

    return check


@pytest.mark.parametrize("home_is_writable", [True, False])
def test_an_installation_that_cannot_be_written_stores_with_the_user(package, tmp_path, home_is_writable):
    temporary, home = tmp_path / "temporary", tmp_path / "home"
    temporary.mkdir()
    if home_is_writable:
        home.mkdir()
    else:
        home.touch()  # no folder can be made in a file, not even by an administrator
    places = {"XDG_CACHE_HOME": home / "cache", "HOME": home, "TMPDIR": temporary}
    for folder in (package, package.parent):
        folder.chmod(0o555)
    before = sorted(package.rglob("*"))
    try:
        assert run(package, VALUE, **places) == "8.0 0 ''"
        assert sorted(package.rglob("*")) == before
    finally:
        for folder in (package.parent, package):
            folder.chmod(0o755)
    assert list(home.rglob("*.nbi")) if home_is_writable else list(temporary.rglob("*.nbi"))


def test_where_nothing_can_be_written_each_process_compiles(package, tmp_path):
    (tmp_path / "file").touch()
    nowhere = f"import tempfile; tempfile.tempdir = {str(tmp_path / 'file')!r}\n{VALUE}"
    places = {"XDG_CACHE_HOME": tmp_path / "file", "HOME": tmp_path / "file"}
    code = nowhere.replace("value.stats.cache_hits.values()", "()")
    assert run(package, code, **places) == "8.0 0 ''"
    assert not list(tmp_path.rglob("*.nbi"))


def test_no_module_stores_machine_code_in_another_way():
    plain = [
        path
        for path in PACKAGE.rglob("*.py")
        if path.name != "compiled.py"
        and "import njit" in path.read_text().replace("compiled import njit", "")
    ]
    assert plain == []


TOLD = """
from contactimg.caller import value
from contactimg.compiled import telling_compilations

told = []
with telling_compilations(lambda begun, declared: told.append((begun, declared))):
    values = value(3.0), value(4.0)
begun, declared = zip(*told)
other = value(5)  # another type is compiled anew, untold
print(*values, other, *begun, min(declared) >= 2, len(told))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_each_function_that_begins_to_be_compiled_is_told(package, tmp_path):
    assert run(package, TOLD, NUMBA_CACHE_DIR=tmp_path / "cache") == "8.0 10.0 12.0 1 2 True 2"


def test_no_compiled_function_carries_the_text_of_an_error():
    """numba checks the shapes of an array assigned to a part of another: that text takes seconds."""
    frame = np.zeros((120, 160), np.float32)
    frame[40:60, 50:70] = 100.0
    measure_image(frame + np.random.default_rng(1).normal(0, 1, frame.shape), frame * 0.0 + 1.0)
    functions = {
        function
        for name, module in list(sys.modules.items())
        if name.startswith("contactimg.")
        for function in vars(module).values()
        if isinstance(function, numba.core.registry.CPUDispatcher)
    }
    stored = {file for one in functions for file in Path(one.stats.cache_path).glob("*.nbc")}
    assert len(stored) > 50
    assert not [file.name for file in stored if b"cpython7unicode" in file.read_bytes()]
