"""Tables of the rooms of the package from their docstrings, in the order of tests/test_layers.py."""

import ast
from pathlib import Path

from reference_pages import markdown_table, write

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "contactimg"


def setup(app):
    """Write the tables as soon as the configuration is read."""
    app.connect("config-inited", _write_tables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write_tables(_app, _config):
    write("rooms.md", _table(PACKAGE, _order("ROOMS")))
    lines = []
    for outer, rooms in _order("INNER_ROOMS").items():
        lines += [f"## Inside `{outer}/`", "", *_table(PACKAGE / outer, rooms)]
    write("inner_rooms.md", lines)


def _order(name):
    """The list or dict of that name in the test that guards the order."""
    tree = ast.parse((ROOT / "tests" / "test_layers.py").read_text(encoding="utf-8"))
    nodes = [node for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == name]
    return ast.literal_eval(nodes[0].value)


def _table(folder, rooms):
    return markdown_table(["room", "holds", "modules"], [_row(folder, room) for room in rooms])


def _row(folder, room):
    path = folder / room
    if path.is_dir():
        names = [module.stem for module in sorted(path.glob("*.py")) if module.stem != "__init__"]
        names += [f"{inner.name}/" for inner in sorted(path.iterdir()) if (inner / "__init__.py").exists()]
        return f"`{room}/`", _purpose(path / "__init__.py"), ", ".join(f"`{name}`" for name in names)
    return f"`{room}`", _purpose(path.with_suffix(".py")), ""


def _purpose(path):
    """First paragraph of a module's docstring."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.split("\n\n")[0].replace("``", "`")
