"""Every function is annotated, unless it is compiled."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "contactimg"
MODULES = sorted(PACKAGE.rglob("*.py"))


def unannotated(tree):
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef) or any("jit" in ast.unparse(d) for d in node.decorator_list):
            continue
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        missing = [a for a in arguments if a.annotation is None and a.arg not in ("self", "cls")]
        if missing or (node.returns is None and not (node.name == "__init__" and len(arguments) > 1)):
            yield node.name


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_functions_that_are_not_compiled_are_annotated(path):
    assert list(unannotated(ast.parse(path.read_text(encoding="utf-8")))) == []


def test_the_check_sees_a_missing_annotation():
    assert list(unannotated(ast.parse("def f(x) -> int:\n    return 1"))) == ["f"]
    assert list(unannotated(ast.parse("@njit\ndef f(x):\n    return 1"))) == []
