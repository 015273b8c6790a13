"""Every import points down: a module imports only from rooms below its own, function-level included."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "contactimg"

# from low to high; modules named in one line are one room and do not import each other's neighbours above
ROOMS = [
    "errors",
    "timings",
    "tables",
    "frame",
    "pose",
    "scene",
    "mechanics",
    "optics",
    "surfaces",
    "imaging",
    "models",
    "effects",
    "matching",
    "forces",
    "render",
    "analysis",
    "calibration",
    "prediction",
    "tradeoff",
    "files",
    "plots",
    "pipeline",
    "report",
    "cli",
]


def room_of(module: str) -> str:
    return module.split(".")[1] if module.count(".") else "__init__"


def imports_of(path: Path) -> set[str]:
    """Rooms that a module imports from, wherever in the module the import stands."""
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [node.module or ""]
            if node.module == "contactimg":
                names = [f"contactimg.{alias.name}" for alias in node.names]
        else:
            continue
        rooms |= {room_of(name) for name in names if name.startswith("contactimg")}
    return rooms


MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_imports_point_down(path):
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if room == "__main__":
        return
    assert room in ROOMS, f"{room} has no place in the house; give it one in ROOMS"
    for imported in imports_of(path) - {room, "__version__"}:
        assert imported in ROOMS, f"{path.name} imports unknown room {imported}"
        assert ROOMS.index(imported) < ROOMS.index(room), f"{room} must not import from {imported}"


def test_the_check_sees_an_upward_import(tmp_path):
    bad = tmp_path / "bad.py"
    bad.write_text(
        "def f():\n    from contactimg.cli import main\n    from contactimg import pipeline\n",
        encoding="utf-8",
    )
    assert imports_of(bad) == {"cli", "pipeline"}
