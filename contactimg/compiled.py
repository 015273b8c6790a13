"""Where the machine code of compiled functions is stored: by the state of the sources that it was made from.

numba notices a change of the file that a function stands in, but none of a function or constant that comes
from another file. Therefore the code of each module lies in a folder named by a digest of the module and of
all modules of this package that it imports, directly or through others. A folder that belongs to another
state of the sources and was not used for a week is removed.

The folders lie in NUMBA_CACHE_DIR where it is set, else in the user's cache directory; where neither can be
written, in the directory of temporary files, or nowhere: then each process compiles anew.
"""

import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event
from platformdirs import user_cache_path

PACKAGE = Path(__file__).parent

UNUSED_SECONDS = 7 * 86400.0
"""Time after which code of other sources is removed. Chosen: longer than a process runs."""

_IMPORT = re.compile(
    rf"^[ \t]*(?:from|import)[ \t]+({PACKAGE.name}[\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|.*))?".encode(),
    re.MULTILINE,
)

_settings: Any = numba.config
_declared: list[str] = []


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does, and store its machine code by the state of the sources.

    Parameters
    ----------
    **options
        Those of `numba.njit`; ``cache`` is on wherever there is a folder that can be written.
    """

    def declare(function: Callable[..., Any]) -> Any:
        folder = _folder_of(function.__module__, Path(function.__code__.co_filename))
        usual = _settings.CACHE_DIR
        _settings.CACHE_DIR = str(folder or usual)
        _declared.append(function.__name__)
        try:
            return numba.njit(**options | {"cache": folder is not None})(function)
        finally:
            _settings.CACHE_DIR = usual

    return declare


@contextmanager
def telling_compilations(tell: Callable[[int, int], None]) -> Iterator[None]:
    """Tell, whenever a function begins to be compiled, how many were until then and how many may be."""

    class Listener(event.Listener):
        begun = 0

        def on_start(self, _event: Any) -> None:
            self.begun += 1
            tell(self.begun, len(_declared))

        def on_end(self, _event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


def digest_of_sources(path: Path) -> str:
    """Digest of a module of this package and of all that it imports from it, of Python and of numba."""
    seen, found = set[Path](), [path]
    while found:
        current = found.pop()
        if current not in seen:
            seen.add(current)
            found += _content(current)[1]
    digest = hashlib.sha256(f"{sys.version} {numba.__version__}".encode())
    for source in sorted(seen):
        digest.update(_content(source)[0])
    return digest.hexdigest()[:16]


@cache
def _content(path: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Digest of a source file, and the files of this package that it imports."""
    text = path.read_bytes()
    names = set[str]()
    for module, imported in _IMPORT.findall(text):
        names.add(module.decode())
        names |= {f"{module.decode()}.{name}" for name in re.findall(r"\w+", imported.decode())}
    modules = [PACKAGE.parent.joinpath(*name.split(".")) for name in names]
    files = [file for one in modules for file in (one.with_suffix(".py"), one / "__init__.py")]
    return hashlib.sha256(text).digest(), tuple(file for file in files if file.is_file())


@cache
def _folder_of(module: str, path: Path) -> Path | None:
    """The folder for the machine code of a module, marked as used now; None where nothing can be stored."""
    if (store := _store()) is None:
        return None
    folder = store / f"{module}-{digest_of_sources(path)}"
    with suppress(OSError):
        if not folder.exists():
            _remove_unused(store.glob(f"{module}-*"))
        folder.mkdir(exist_ok=True)
        os.utime(folder)
        return folder
    return None


@cache
def _store() -> Path | None:
    """The first folder that can be written and belongs to this user."""
    usual, temporary = _settings.CACHE_DIR or user_cache_path("contactimg"), tempfile.gettempdir()
    for folder in (Path(usual), Path(temporary) / f"contactimg-{os.getuid() if os.name == 'posix' else ''}"):
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            # stored code is run: in a folder that all can write, only one's own is trusted
            if str(folder.parent) != temporary or os.name != "posix" or folder.stat().st_uid == os.getuid():
                return folder
    return None


def _remove_unused(folders: Iterable[Path]) -> None:
    """Remove those of the folders that no process has used for some time."""
    for folder in folders:
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > UNUSED_SECONDS:
                shutil.rmtree(folder)


@njit(cache=True)
def lengthened(rows: Any) -> Any:
    """A table with the same rows and space for as many more.

    Compiled functions copy number by number: numba checks the shapes of an array that is assigned to a part
    of another, and the text of that error alone takes seconds to compile.
    """
    out = np.empty((2 * len(rows), rows.shape[1]), rows.dtype)
    for i in range(len(rows)):
        for j in range(rows.shape[1]):
            out[i, j] = rows[i, j]
    return out
