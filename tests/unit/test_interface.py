"""What users meet before they call anything: what an import costs, what a tab and `help` show."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import mexpress as mx
import mexpress.sklearn

PACKAGE = Path(mx.__file__).parent
MODULES = [mx, mx.criteria, mx.io, mx.liftings, mx.placement, mx.schemes, mx.simulation, mexpress.sklearn]


def loaded_by(program):
    """Names of the modules that a program imports."""
    program += "\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def public():
    """Functions, classes and methods that users call, by their names."""
    for module in MODULES:
        for name in module.__all__:
            value = getattr(module, name)
            if value is mx.RankLossWarning:  # Python knows no signature of exceptions
                continue
            if inspect.isclass(value):
                for method, function in inspect.getmembers(value, callable):
                    ours = method in vars(value) or module is not mexpress.sklearn
                    if (
                        ours
                        and (method == "__call__" or not method.startswith("_"))
                        and "_request" not in method
                    ):
                        yield f"{name}.{method}", function
            if callable(value):
                yield name, value


def test_an_import_is_light():
    light = loaded_by("import mexpress")
    assert light - loaded_by("import numpy") == {"__future__", "mexpress", "mexpress._core"}
    used = loaded_by("import mexpress\nmexpress.select_warp")
    assert "mexpress.selection" in used
    for heavy in ("importlib.metadata", "concurrent.futures", "multiprocessing", "logging.config", "zipfile"):
        assert heavy not in used
    assert not {"mexpress.batch", "mexpress.cli", "mexpress.plotting", "mexpress.simulation"} & used


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_is_there_and_a_tab_shows_no_other(module):
    assert dir(module) == sorted([*module.__all__, *(["__version__"] if module is mx else [])])
    for name in module.__all__:
        assert getattr(module, name) is not None


def test_what_type_checkers_see_is_what_there_is():
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    (typed,) = (node for node in tree.body if ast.unparse(node).startswith("if TYPE_CHECKING"))
    seen = {
        alias.name: node.module
        for node in typed.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    del seen["Any"]
    assert sorted(seen) == mx.__all__
    homes = {name: home for home, names in mx._HOMES.items() for name in names}
    assert {name: home for name, home in seen.items() if home != "mexpress"} == homes


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'mexpress' has no attribute 'select_wrap'"):
        mx.select_wrap  # noqa: B018


def test_help_shows_signatures_as_they_are_written():
    names = dict(public())
    assert {"select_warp", "Warp.remap", "lloyd", "Selection.plot"} <= names.keys()
    for name, function in names.items():
        text = str(inspect.signature(function))
        for long in ("numpy", "typing.", "collections.", "mexpress"):
            assert long not in text, name
