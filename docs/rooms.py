"""Draw docs/rooms.png: the rooms of the code, and which of them imports which, read from the code (`make rooms`)."""

import ast
import math
from collections.abc import Iterable, Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

DOCS = Path(__file__).parent
PICTURE = DOCS / "rooms.png"
PACKAGE = DOCS.parent / "python" / "mexpress"


class Room(NamedTuple):
    """A folder or file of the package: its place, what is in it, and which steps of architecture.md's walk are."""

    column: float
    row: float
    content: str
    steps: tuple[int, ...] = ()


ROOMS = {
    "paper": Room(2, 8, "its tables and figures"),
    "datasets": Room(1, 8, "data with a known truth"),
    "simulation": Room(1, 7, "sheets and cameras"),
    "cli": Room(2, 7, "the command line"),
    "batch": Room(3, 7, "many problems"),
    "sklearn": Room(0, 7, "estimators"),
    "selection": Room(2, 6, "tries and chooses", (1, 9)),
    "report": Room(3, 5, "one page"),
    "plotting": Room(4, 4, "figures"),
    "suspicion": Room(0, 3, "datum by datum"),
    "radii": Room(1, 3, "by the radius"),
    "criteria": Room(2, 3, "by a name", (6, 8)),
    "models": Room(3, 3, "warps and surfaces", (4, 10)),
    "leastsquares": Room(1, 2, "fit and predict", (5, 7)),
    "liftings": Room(3, 2, "functions that bend", (3,)),
    "io": Room(4, 2, "files of data"),
    "schemes": Room(1, 1, "what is held out", (6,)),
    "placement": Room(3, 1, "control points", (2,)),
}
GROUND = [
    "_validation",
    "extras",
    "geometry",
    "index_sets",
    "logger",
    "notebook",
    "progress",
    "records",
    "resampling",
]
RUST = ["evaluate", "fit", "holdout", "near", "place"]
NOT_DRAWN = ["__init__", "__main__", "versions"]

SIZE = (0.86, 0.52)
INK, FILL, STEP = "#222222", "#e8eef5", "#b3003b"

Arrows = dict[tuple[str, str], bool]


def imported(statements: Iterable[ast.AST], late: bool = False) -> Iterator[tuple[str, bool]]:
    """Return the names that statements import, and whether only where they are used; not those for types alone."""
    for node in statements:
        if isinstance(node, ast.Import | ast.ImportFrom):
            prefix = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            yield from ((prefix + alias.name, late) for alias in node.names)
        elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield from imported(ast.iter_child_nodes(node), late or isinstance(node, ast.FunctionDef))


def read_arrows() -> Arrows:
    """Return who imports whom, and whether only where it is used; without what other arrows imply."""
    found: Arrows = {}
    for file in PACKAGE.rglob("*.py"):
        here = file.relative_to(PACKAGE).with_suffix("").parts[0]
        for name, late in imported(ast.parse(file.read_text()).body):
            if name.startswith("mexpress."):
                pair = here, name.split(".")[1]
                found[pair] = late and found.get(pair, True)
    unknown = {here for here, _ in found} - {*ROOMS, *GROUND, *NOT_DRAWN}
    if unknown:
        raise SystemExit(f"docs/rooms.py has no place for {', '.join(sorted(unknown))}.")
    return reduced({(a, b): late for (a, b), late in found.items() if a != b and a in ROOMS and b in ROOMS})


def reduced(arrows: Arrows) -> Arrows:
    """Leave out arrows that longer ways imply."""
    below = {name: {b for (a, b), late in arrows.items() if a == name and not late} for name in ROOMS}
    for name in TopologicalSorter(below).static_order():
        below[name] |= {far for near in below[name] for far in below[near]}
    implied = {(a, far) for (a, b), late in arrows.items() if not late for far in below[b]}
    return {pair: late for pair, late in sorted(arrows.items()) if pair not in implied}


def draw(picture: Path = PICTURE) -> None:
    """Draw every room, what all of them stand on, and the arrows from each to what it imports."""
    figure, axes = plt.subplots(figsize=(10, 10.4))
    axes.set(xlim=(-0.5, 4.5), ylim=(-1.2, 8.3))
    axes.axis("off")
    for name, here in ROOMS.items():
        box(axes, here.column, here.row, SIZE, name, here.content)
        for i, step in enumerate(here.steps):
            place = here.column - SIZE[0] / 2, here.row + 0.13 * (len(here.steps) - 1) - 0.26 * i
            badge = {"boxstyle": "circle,pad=0.15", "facecolor": STEP, "edgecolor": "white"}
            axes.text(
                *place, f"{step}", size=8, weight="bold", color="white", ha="center", va="center", bbox=badge
            )
    box(axes, 2, -0.1, (4.97, SIZE[1]), "  ".join(GROUND), "all rooms stand on these")
    box(axes, 2, -0.9, (4.97, SIZE[1]), "_core:     " + "     ".join(RUST), "mathematics on slices, in Rust")
    arrows = read_arrows()
    for pair, late in arrows.items():
        line = {
            "arrowstyle": "-|>",
            "color": INK,
            "linestyle": "--" if late else "-",
            "shrinkA": 0,
            "shrinkB": 0,
        }
        axes.annotate("", anchor(arrows, pair, 1), anchor(arrows, pair, 0), arrowprops=line)
    figure.savefig(picture, dpi=130, bbox_inches="tight", metadata={"Description": described(arrows)})
    plt.close(figure)


def box(axes: Axes, x: float, y: float, size: tuple[float, float], name: str, content: str) -> None:
    """Draw a room with its name and what is in it."""
    corner = x - size[0] / 2, y - size[1] / 2
    axes.add_patch(
        FancyBboxPatch(corner, *size, "round,pad=0,rounding_size=0.06", facecolor=FILL, edgecolor=INK)
    )
    axes.text(x, y + 0.07, name, size=10.5, weight="bold", color=INK, ha="center", va="center")
    axes.text(x, y - 0.13, content, size=8, color=INK, ha="center", va="center")


def anchor(arrows: Arrows, pair: tuple[str, str], end: int) -> tuple[float, float]:
    """Return where an arrow leaves the importing room (end 0) or reaches the other (end 1).

    Those of one side stand in the order of their other ends, so that they do not cross there.
    """
    here, there = ROOMS[pair[end]], ROOMS[pair[1 - end]]
    if here.row == there.row:
        return here.column + math.copysign(SIZE[0] / 2, there.column - here.column), here.row
    others = [p for p in arrows if p[end] == pair[end] and ROOMS[p[0]].row > ROOMS[p[1]].row]
    others.sort(key=lambda p: ROOMS[p[1 - end]].column)
    place = others.index(pair) - (len(others) - 1) / 2
    return here.column + 0.13 * place, here.row + math.copysign(SIZE[1] / 2, there.row - here.row)


def described(arrows: Arrows) -> str:
    """Return the arrows as text, which the picture carries: a test compares it with the code."""
    return "; ".join(f"{a} {'uses' if late else 'imports'} {b}" for (a, b), late in arrows.items())


if __name__ == "__main__":
    draw()
