"""Functions and modules stay small enough to be read at a glance."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "contactimg"
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST_PARAMETERS, MOST_BODY_LINES, MOST_MODULE_LINES = 8, 40, 500

# public functions whose keywords each state one quantity of the problem
PUBLIC_WITH_MORE_PARAMETERS = {
    "measure_image",
    "measure_frame",
    "solve_interacting",
    "solve_adhesive",
    "solve_ensemble",
    "solve_greenwood_tripp",
    "calibrate_jkr",
}


def functions(path):
    """Each function of a module with whether it is compiled."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            yield node, any("njit" in ast.unparse(decorator) for decorator in node.decorator_list)


def body_lines(function):
    """Lines of the body without the docstring."""
    documented = ast.get_docstring(function) is not None
    statements = function.body[1:] if documented else function.body
    return statements[-1].end_lineno - statements[0].lineno + 1 if statements else 0


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_functions_and_modules_are_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_MODULE_LINES, path
    for function, compiled in functions(path):
        arguments = function.args
        count = len(arguments.posonlyargs + arguments.args + arguments.kwonlyargs)
        own = count - (bool(arguments.args) and arguments.args[0].arg in ("self", "cls"))
        name = f"{path}:{function.lineno} {function.name}"
        if not compiled:
            assert own <= MOST_PARAMETERS or function.name in PUBLIC_WITH_MORE_PARAMETERS, name
            assert body_lines(function) <= MOST_BODY_LINES, f"{name}: {body_lines(function)} lines"
