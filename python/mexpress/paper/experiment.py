"""What every experiment is: a name, what it needs, and a function from options to an outcome.

Examples
--------
>>> Experiment("nothing", "prints nothing", "", lambda options: Outcome("", {}, [])).name
'nothing'
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mexpress import _validation as check


@dataclass(frozen=True)
class Options:
    """What a run is told.

    Parameters
    ----------
    data : Path or None
        File or directory that the reader supplies; None for what the experiment simulates.
    out : Path
        Directory for everything that is written; it exists.
    quick : bool
        A smaller run of the same kind, within two minutes.
    seed : int
        Of everything random.
    threads : int, optional
        At most so many cores; MEXPRESS_NUM_THREADS or all of them if None.
    progress : bool
        Whether to show progress on the terminal.
    plots : bool
        Whether to draw figures.

    Raises
    ------
    ValueError, TypeError
        If the seed or the number of threads, which MEXPRESS_NUM_THREADS may have, is none.

    Examples
    --------
    >>> Options(None, Path("out"), quick=True).seed
    0
    """

    data: Path | None
    out: Path
    quick: bool = False
    seed: int = 0
    threads: int | None = None
    progress: bool = True
    plots: bool = True

    def __post_init__(self) -> None:
        check.count(self.seed, "seed", 0)
        check.threads(self.threads)


@dataclass(frozen=True)
class Outcome:
    """What a run found.

    Parameters
    ----------
    report : str
        Text to be printed: tables, our numbers beside the paper's, claims and whether they hold.
    summary : dict
        The same as JSON has it: plain numbers, lists and dicts, None for what is undefined.
    files : list of str
        Names of what was written into the output directory.
    plots : dict of str to callable
        Names of plots, and what draws each into a file whose path it takes: to be called last, when what the run
        found is safe.

    Examples
    --------
    >>> Outcome("nothing found", {}).files
    []
    """

    report: str
    summary: dict[str, Any]
    files: list[str] = field(default_factory=list)
    plots: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper.

    Parameters
    ----------
    name : str
        As the command line has it.
    summary : str
        One line for its help.
    data : str
        What it takes: "DIR", "FILE", or "" for nothing; without them it simulates.
    run : callable
        Makes it.

    Examples
    --------
    >>> run = lambda options: Outcome(f"seed {options.seed}", {})
    >>> Experiment("seed", "says its seed", "", run).run(Options(None, Path("."), seed=3)).report
    'seed 3'
    """

    name: str
    summary: str
    data: str
    run: Callable[[Options], Outcome]
