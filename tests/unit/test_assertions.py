"""No test without a sentence that can be wrong."""

import ast
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1]
HELPERS = sorted(FOLDER.glob("*.py"))


def functions(file):
    return {node.name: node for node in ast.parse(file.read_text()).body if isinstance(node, ast.FunctionDef)}


def claims(function, known):
    """Tell whether a function asserts something, itself or by a function that it calls."""
    for node in ast.walk(function):
        if isinstance(node, ast.Assert):
            return True
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            if name.startswith("assert_") or name in {"raises", "warns", "fail"}:
                return True
            others = {other: known[other] for other in known if other != function.name}
            if name in others and claims(others[name], others):
                return True
    return False


@pytest.mark.parametrize("file", sorted(FOLDER.rglob("test_*.py")), ids=lambda file: file.stem)
def test_every_test_asserts_something(file):
    known = {name: node for source in [*HELPERS, file] for name, node in functions(source).items()}
    tests = [function for name, function in known.items() if name.startswith("test_")]
    assert tests
    assert [test.name for test in tests if not claims(test, known)] == []
