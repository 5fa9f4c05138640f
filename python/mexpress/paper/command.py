"""`mexpress reproduce`: the paper's tables and figures."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mexpress.cli import common
from mexpress.cli import report as reports
from mexpress.paper import EXPERIMENTS, Experiment, Options, Outcome
from mexpress.plotting.figures import new_figure
from mexpress.versions import versions


def add_reproduce(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command, with a command of its own for each experiment."""
    parser = commands.add_parser(
        "reproduce",
        help="make a table or figure of the paper",
        description="Make a table or figure of the paper. The output directory gets NAME.json, tables as CSV and "
        "plots as PNG. table1 and table2, if interrupted, continue where they stopped, from the rows that the "
        "directory holds; figure2 and figure3 use table1's rows, and continue them too. The other figures start "
        "anew.",
    )
    experiments = parser.add_subparsers(title="experiments", required=True, metavar="NAME")
    for experiment in EXPERIMENTS.values():
        _add_experiment(experiments, experiment)


def _add_experiment(experiments: argparse._SubParsersAction[common.Parser], experiment: Experiment) -> None:
    parser = experiments.add_parser(
        experiment.name, help=experiment.summary, description=f"{experiment.name}: {experiment.summary}."
    )
    if experiment.data:
        simulated = "the data (default: what the experiment simulates)"
        parser.add_argument("data", metavar=experiment.data, type=Path, nargs="?", help=simulated)
    parser.add_argument(
        "--quick", action="store_true", help="a smaller run of the same kind, within two minutes"
    )
    common.add_run(parser)
    parser.set_defaults(run=lambda arguments: _run(experiment, arguments), data=None)


def _run(experiment: Experiment, arguments: argparse.Namespace) -> None:
    options = Options(
        data=_existing(arguments.data, experiment.data),
        out=arguments.out,
        quick=arguments.quick,
        seed=arguments.seed,
        threads=arguments.threads,
        progress=not arguments.quiet,
        plots=arguments.plots and _can_plot(),
    )
    options.out.mkdir(parents=True, exist_ok=True)
    outcome = experiment.run(options)
    name = f"{experiment.name}.json"
    command = {"experiment": experiment.name, **_command(options)}
    summary = {"versions": versions(), "command": command, **outcome.summary}
    reports.write_summary(options.out / name, summary)
    try:
        if not arguments.json:
            print(outcome.report, flush=True)
    finally:  # though the reader, such as head, may have seen enough
        drawn = _drawn(outcome, options) if options.plots else []
    common.print_end(arguments, name, [name, *outcome.files, *drawn])


def _drawn(outcome: Outcome, options: Options) -> list[str]:
    """Draw the plots; return the names of those that could be."""
    names = []
    for name, draw in outcome.plots.items():
        try:
            draw(options.out / name)
        except Exception as error:  # whatever it is, the numbers are there
            common.warn(f"no {name}. {type(error).__name__}: {error}")
        else:
            names.append(name)
    return names


def _can_plot() -> bool:
    """Whether plots can be made: known now, since the numbers of a long run are worth more than its plots."""
    try:
        new_figure(1, 1)
    except ImportError as error:
        common.warn(f"no plots. {error}")
        return False
    return True


def _existing(data: Path | None, kind: str) -> Path | None:
    """Return the data, if they are what the experiment takes: now, so that a wrong name costs no time."""
    if data is None:
        return None
    if not data.exists():
        raise FileNotFoundError(2, "No such file or directory", str(data))
    if (kind == "DIR") != data.is_dir():
        wanted, actual = ("a directory", "a file") if kind == "DIR" else ("a file", "a directory")
        raise common.UsageError(f"{kind} must be {wanted}, but {data} is {actual}")
    return data


def _command(options: Options) -> dict[str, Any]:
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in vars(options).items()
        if name not in {"progress", "plots"}
    }
