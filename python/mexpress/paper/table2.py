"""Table 2 and figures 4 to 6: which warp to transfer a contour with, in flat, rigid and deformable scenes.

Every criterion selects the number of control points of fractional warps and, for contrast, of linear ones, from 51, 103
and 206 matches; the Jaccard index then tells how well the selected warp transfers a contour, of which no criterion
knows. Without data the scenes are simulated, with affine and with perspective cameras; `mexpress.paper.two_views`
tells what a reader's directory holds. Where no contour is known, the error at matches that were left out tells instead.

Examples
--------
>>> TABLE2.name, FIGURE4.data
('table2', 'DIR')
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mexpress import _validation as check
from mexpress.batch import map_problems
from mexpress.io.matches import write_rows
from mexpress.io.records import Records
from mexpress.paper.experiment import Experiment, Options, Outcome
from mexpress.paper.plot_scenes import plot_choices, plot_scene
from mexpress.paper.table2_cells import BEST, COLUMNS, KEY, Cell, Choice, Table, cells, choices, losses, table
from mexpress.paper.table2_claims import findings
from mexpress.paper.transfer import Trial, trial
from mexpress.paper.two_views import Recorded, Scene, Simulated, digest, read_scenes
from mexpress.selection import largest_count
from mexpress.simulation.scenes import KINDS, PROJECTIONS

FORMS = ("fractional", "linear")

SHOWN = ("FIT", "PRESS", "CMPRESS", "KF10", "ER05", "ER10", "NN05PCT", "NN10PCT", BEST)
"""Of the criteria, those that are printed and drawn; files have all."""

DRAWS, QUICK_DRAWS = 10, 5
"""So many draws; a quick run has fewer, and the least of a scene's numbers of matches only."""

FIGURE_MATCHES = 103
"""So many matches in a figure, or what is next below."""

NOTES = """l: number of control points; FIT: pixels; mean±std over the draws of matches and noise, if there are several.
BEST: the number with the best Jaccard index, or else the least transfer error; no criterion knows it.
! in some draw the denominator vanishes on the contour: nothing is transferred, and the Jaccard index counts as 0."""

NO_CONTOUR = """transfer: where no contour is known, the root mean square error, in pixels, at matches that were left
out, their own noise included; median over the draws."""


@dataclass(frozen=True)
class _Task:
    """One trial of the table."""

    scene: Scene
    form: str
    n: int
    draw: int
    seed: int

    @property
    def key(self) -> tuple[str, str, int, int]:
        return self.scene.name, self.form, self.n, self.draw


def _table2(options: Options) -> Outcome:
    """Run all trials and sum them up."""
    scenes = _scenes(options)
    kinds = {scene.name: scene.kind for scene in scenes}
    projections = {scene.name: scene.projection for scene in scenes if isinstance(scene, Simulated)}
    order = {scene.name: k for k, scene in enumerate(scenes)}
    made = sorted(
        choices(_rows(options, scenes)), key=lambda choice: (order[choice.scene], choice.form, choice.n)
    )
    table_cells = cells(made)
    claims = findings(table_cells, kinds, projections)
    with (options.out / "table2.csv").open("w", encoding="utf-8", newline="\n") as file:
        names = [field.name for field in fields(Cell)]
        write_rows(file, names, ([getattr(cell, name) for name in names] for cell in table_cells))
    parts = [_explained(table_cells), losses(made, kinds, SHOWN), "\n".join(claim.text for claim in claims)]
    summary = {
        "cells": [asdict(cell) for cell in table_cells],
        "findings": [asdict(finding) for finding in claims],
    }
    return Outcome(
        "\n\n".join(part for part in parts if part),
        summary,
        ["table2_rows.csv", "table2.csv"],
        {"table2.png": lambda path: plot_choices(table_cells, SHOWN, path)},
    )


def _explained(table_cells: Sequence[Cell]) -> str:
    """The table, and what its signs mean."""
    notes = [table(table_cells, SHOWN) + "\n", NOTES]
    return "\n".join(
        [*notes, *([NO_CONTOUR] if any(math.isnan(cell.jaccard) for cell in table_cells) else [])]
    )


def _scenes(options: Options) -> list[Scene]:
    if options.data is not None:
        return list(read_scenes(options.data))
    return [Simulated(kind, projection) for kind in KINDS for projection in PROJECTIONS]


def _rows(options: Options, scenes: Sequence[Scene]) -> Table:
    """Run the trials that the output directory does not hold yet; return the rows of all."""
    recorded = [scene for scene in scenes if isinstance(scene, Recorded)]
    data = digest(recorded) if recorded else None
    run = {"experiment": "table2", "data": data, "quick": options.quick, "seed": options.seed}
    tasks = _tasks(options, scenes)
    with Records(options.out / "table2_rows.csv", run, COLUMNS, KEY) as records:
        left = [task for task in tasks if task.key not in records]
        map_problems(
            _tried,
            [(task,) for task in left],
            workers=options.threads,
            progress=options.progress,
            on_result=lambda index, rows: records.add(rows),
        )
        return records.table()


def _tasks(options: Options, scenes: Sequence[Scene]) -> list[_Task]:
    """All trials, those that take longest first."""
    tasks = []
    for scene in scenes:
        light = replace(scene, images=None) if isinstance(scene, Recorded) else scene
        for n in scene.sizes[:1] if options.quick else scene.sizes:
            for draw in range(scene.repeats(n, QUICK_DRAWS if options.quick else DRAWS)):
                tasks += [_Task(light, form, n, draw, _seed(options, draw)) for form in FORMS]
    return sorted(tasks, key=lambda task: (-task.n, task.form, task.draw))


def _seed(options: Options, draw: int) -> int:
    """What a draw's scene is made with: those of different runs do not meet."""
    return 1000 * options.seed + draw


def _tried(task: _Task) -> list[tuple[Any, ...]]:
    """Return the rows of a trial."""
    problem = task.scene.draw(task.n, task.seed)
    counts = range(3, largest_count(task.n) + 1)
    judged = trial(problem, task.form == "fractional", counts, seed=task.seed, threads=1)
    return [(*task.key, *row) for row in _numbers(judged)]


def _numbers(judged: Trial) -> list[tuple[Any, ...]]:
    """Return a row for each number of control points: this number, then what `COLUMNS` has after it."""
    curves = {**judged.selection.curves, **judged.measures()}
    columns = [curves[name].tolist() for name in list(COLUMNS)[KEY + 1 :]]
    return list(zip(judged.selection.counts.tolist(), *columns, strict=True))


def _figure(name: str, kind: str, options: Options) -> Outcome:
    """Show one draw of a scene: criteria, and contours that their choices transfer."""
    scene = _scene(kind, options)
    fitting = [n for n in scene.sizes if n <= FIGURE_MATCHES]
    n = scene.sizes[0] if options.quick or not fitting else fitting[-1]
    seed, counts = _seed(options, 0), range(3, largest_count(n) + 1)
    problem = scene.draw(n, seed)
    how: dict[str, Any] = {"seed": seed, "threads": options.threads, "progress": options.progress}
    trials = {form: trial(problem, form == "fractional", counts, **how) for form in FORMS}
    _write_curves(options.out / f"{name}.csv", trials)
    images = scene.images if isinstance(scene, Recorded) else None
    table_cells = cells(
        choice for form, judged in trials.items() for choice in _chosen(scene.name, form, judged)
    )
    summary = {"scene": scene.name, "n": n, "cells": [asdict(cell) for cell in table_cells]}
    plots = {f"{name}.png": lambda path: plot_scene(trials, scene.name, images, path)}
    return Outcome(_explained(table_cells), summary, [f"{name}.csv"], plots)


def _scene(kind: str, options: Options) -> Scene:
    """The scene of a figure: simulated in perspective, or the reader's one of the kind that has most matches."""
    if options.data is None:
        return Simulated(kind, "perspective")
    fitting = [scene for scene in read_scenes(options.data) if scene.kind == kind]
    if not fitting:
        rule = f"The directory must hold a scene whose kind is {kind}, as scenes.json has it."
        check.refuse("data", rule, str(options.data))
    return max(fitting, key=lambda scene: len(scene.source))


def _chosen(scene: str, form: str, judged: Trial) -> list[Choice]:
    """Return what the criteria choose in one trial."""
    counts = judged.selection.counts
    same = {"scene": scene, "form": form, "n": len(judged.problem.source), "draw": 0}
    columns = {name: np.array([value] * len(counts)) for name, value in same.items()}
    return list(choices({**columns, "count": counts, **judged.selection.curves, **judged.measures()}))


def _write_curves(path: Path, trials: Mapping[str, Trial]) -> None:
    names = list(COLUMNS)[KEY + 1 :]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        rows = [(form, *row) for form, judged in trials.items() for row in _numbers(judged)]
        write_rows(file, ["form", "count", *names], rows)


TABLE2 = Experiment(
    "table2",
    "what criteria select in flat, rigid and deformable scenes, and how well it transfers a contour",
    "DIR",
    _table2,
)
FIGURE4, FIGURE5, FIGURE6 = (
    Experiment(
        name, f"contours transferred in a {kind} scene, and the criteria", "DIR", partial(_figure, name, kind)
    )
    for name, kind in (("figure4", "flat"), ("figure5", "rigid"), ("figure6", "deformable"))
)
