"""Every import points down: a module imports only from rooms below its own, function-level included."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "contactimg"

# from low to high; modules named in one line are one room and do not import each other's neighbours above
ROOMS = [
    "errors",
    "compiled",
    "timings",
    "engine",
    "tables",
    "frame",
    "pose",
    "scene",
    "mechanics",
    "optics",
    "render",
    "surfaces",
    "summits",
    "plausibility",
    "imaging",
    "models",
    "sliding",
    "design",
    "effects",
    "forces",
    "analysis",
    "shear",
    "calibration",
    "prediction",
    "tradeoff",
    "files",
    "plots",
    "pipeline",
    "report",
    "review",
    "napari_plugin",
    "cli",
]


# the order inside rooms that have rooms of their own
INNER_ROOMS = {
    "imaging": [
        "pixels",
        "profile",
        "kernels",
        "detect",
        "background",
        "foreground",
        "fit",
        "evidence",
        "count",
        "pooled",
        "smooth",
        "measure",
    ],
    "pipeline": [
        "inputs",
        "results",
        "each_frame",
        "frame",
        "pooled_background",
        "measured_series",
        "series",
        "pictures",
        "calibrate",
        "check",
        "predict",
        "simulate",
        "overlay",
        "analyse",
        "tradeoff",
        "export",
    ],
}


def room_of(module: str) -> str:
    return module.split(".")[1] if module.count(".") else "__init__"


@cache
def modules_imported_by(path: Path) -> frozenset[str]:
    """Modules of the package that a module imports, wherever in the module the import stands."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            names = [module] + [f"{module}.{alias.name}" for alias in node.names]
            if module == "contactimg":
                names = names[1:]
        else:
            continue
        modules |= {name for name in names if name.startswith("contactimg") and is_module(name)}
    return frozenset(modules)


@cache
def is_module(name: str) -> bool:
    """Whether a dotted name is a module or a package, not something defined in one."""
    path = PACKAGE.parent.joinpath(*name.split("."))
    return path.with_suffix(".py").exists() or (path / "__init__.py").exists()


def imports_of(path: Path) -> set[str]:
    """Rooms that a module imports from."""
    return {room_of(name) for name in modules_imported_by(path)}


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


INNER = [path for path in MODULES if path.relative_to(PACKAGE).parts[0] in INNER_ROOMS]


@pytest.mark.parametrize("path", INNER, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_imports_inside_a_room_point_down(path):
    outer, room = (part.removesuffix(".py") for part in path.relative_to(PACKAGE).parts[:2])
    if room == "__init__":
        return
    order = INNER_ROOMS[outer]
    for imported in modules_imported_by(path):
        parts = imported.split(".")
        if len(parts) > 2 and parts[1] == outer and parts[2] != room:
            assert order.index(parts[2]) < order.index(room), f"{path} must not import {imported}"


def test_no_module_imports_itself_through_others():
    names = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path for path in MODULES}
    graph = {name: modules_imported_by(path) & set(names) for name, path in names.items()}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the cycle


def test_the_check_sees_an_upward_import(tmp_path):
    bad = tmp_path / "bad.py"
    bad.write_text(
        "def f():\n    from contactimg.cli import main\n    from contactimg import pipeline\n",
        encoding="utf-8",
    )
    assert imports_of(bad) == {"cli", "pipeline"}
