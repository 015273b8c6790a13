"""What the bits of a result depend on besides its input: the code of contactimg and of its libraries."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "numba", "pandas", "opencv-python-headless", "scikit-image", "finufft")
"""Libraries that compute numbers."""


@cache
def source_digest() -> str:
    """SHA-256 of the code of contactimg: two versions under development have the same number."""
    digest = hashlib.sha256()
    top = Path(__file__).parents[1]
    for path in sorted(top.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def installation() -> dict[str, str]:
    """Name -> version of whatever computes numbers."""
    versions = {name: version(name) for name in LIBRARIES}
    return {"contactimg": source_digest()[:12], "python": platform.python_version()} | versions


def difference(one: dict[str, str], other: dict[str, str]) -> str:
    """What differs between two installations; empty if nothing does.

    Examples
    --------
    >>> difference({"numpy": "2.1.0", "scipy": "1.14"}, {"numpy": "2.2.0", "scipy": "1.14"})
    'numpy 2.1.0 against 2.2.0'
    """
    names = [name for name in one | other if one.get(name) != other.get(name)]
    return ", ".join(f"{name} {one.get(name)} against {other.get(name)}" for name in names)
