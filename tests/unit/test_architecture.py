"""Which module imports which: no circle, no back door, and nothing that must be installed but numpy."""

import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import mexpress

ROOT = Path(mexpress.__file__).parent
TREES = {file: ast.parse(file.read_text()) for file in [*ROOT.rglob("*.py"), ROOT / "_core.pyi"]}
PATHS = {file: ".".join(file.relative_to(ROOT.parent).with_suffix("").parts) for file in TREES}
MODULES = {PATHS[file].removesuffix(".__init__"): tree for file, tree in TREES.items()}
INSTALLED = sys.stdlib_module_names | {"mexpress", "numpy"}


def targets(nodes):
    """Names that the import statements among the nodes ask for, from the top: package.module.name."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import: {ast.unparse(node)}"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def own_imports(tree):
    """Modules of the package that a module imports: at its top, where used, or for types only."""
    for name in targets(ast.walk(tree)):
        if name.split(".")[0] == "mexpress":
            # A package that a module's name leads through is no import of it: siblings may import one another.
            yield name if name in MODULES else name.rpartition(".")[0]


def room(module):
    """Folder or file of the package that a module is in."""
    return ".".join(module.split(".")[:2])


IMPORTS = {module: set(own_imports(tree)) for module, tree in MODULES.items()}
ROOMS = {name: set() for name in map(room, IMPORTS)}
for module, others in IMPORTS.items():
    ROOMS[room(module)] |= {room(other) for other in others} - {room(module)}


@pytest.mark.parametrize("graph", [IMPORTS, ROOMS], ids=["modules", "rooms"])
def test_imports_run_in_no_circle(graph):
    assert graph["mexpress"]  # or nothing was read
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" is imported by ".join(error.args[1]))


def test_plots_know_nothing_of_selection():
    assert "mexpress.selection" not in ROOMS["mexpress.plotting"]


@pytest.mark.parametrize(
    ("name", "users"),
    [("mexpress.paper", set()), ("mexpress.cli", {"mexpress.paper", "mexpress.__main__"})],
)
def test_nothing_is_built_on_what_stands_at_the_top(name, users):
    assert {user for user, rooms in ROOMS.items() if name in rooms} <= users


def test_what_is_optional_is_imported_where_it_is_used():
    # A module's body has no statements of its functions, nor those under `if TYPE_CHECKING`.
    needed = {(module, name.split(".")[0]) for module, tree in MODULES.items() for name in targets(tree.body)}
    others = {(module, library) for module, library in needed if library not in INSTALLED}
    # Estimators are subclasses of those of scikit-learn.
    assert {each for each in others if not each[0].startswith("mexpress.sklearn")} == set()
    assert {library for _, library in others} == {"sklearn"}


def test_nothing_of_the_package_needs_scikit_learn():
    assert {user for user, rooms in ROOMS.items() if "mexpress.sklearn" in rooms} == set()
