"""Which wrong matches are found? Some are planted in real matches, and looked for.

    python experiments/suspects.py DATA

DATA is a folder with sheets/*.npz (image_points (views, n, 2), visible (views, n)) and flat/*_matches.npz (tentative
(n, 4), H_A_to_B (3, 3)). Prints the table of docs/suspects.md.
"""

import argparse
import math
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np

import mexpress as mx
from mexpress.suspicion import SuspicionWarning

SHARES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
VIEWS = ((0, 3), (2, 7), (5, 9))
SEEDS = range(3)


def problems(folder):
    """Name, source, target: matches that are right but for noise."""
    for path in sorted((folder / "sheets").glob("*.npz")):
        arrays = np.load(path)
        if "image_points" in arrays:
            for a, b in VIEWS:
                seen = arrays["visible"][a] & arrays["visible"][b]
                yield path.stem, *(arrays["image_points"][view][seen] for view in (a, b))
    for path in sorted((folder / "flat").glob("*_matches.npz")):
        arrays = np.load(path)
        source, target = np.split(arrays["tentative"].astype(float), 2, axis=1)
        mapped = np.column_stack([source, np.ones(len(source))]) @ arrays["H_A_to_B"].T
        right = np.hypot(*(mapped[:, :2] / mapped[:, 2:] - target).T) < 3
        _, first = np.unique(
            source[right].round(1), axis=0, return_index=True
        )  # a point may be matched twice
        yield path.stem.removesuffix("_matches"), source[right][np.sort(first)], target[right][np.sort(first)]


def planted(target, share, permuted, rng):
    """Targets with wrong ones among them, and which these are."""
    count = round(share * len(target))
    wrong = np.sort(rng.choice(len(target), max(count, 2 * permuted) if count else 0, replace=False))
    spoilt = target.copy()
    if permuted:
        order = rng.permutation(wrong)
        spoilt[order] = target[np.roll(order, 1)]
    else:
        spoilt[wrong] = rng.uniform(target.min(axis=0), target.max(axis=0), (len(wrong), 2))
    return spoilt, wrong


def main():
    """Plant, look, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    folder = parser.parse_args().data
    warnings.simplefilter("ignore", SuspicionWarning)
    rows = defaultdict(list)
    for name, source, target in problems(folder):
        for share in SHARES:
            for permuted in (False, True):
                for seed in SEEDS if share else [0]:
                    rng = np.random.default_rng(seed)
                    spoilt, wrong = planted(target, share, permuted, rng)
                    found = mx.select_warp(source, spoilt, counts=[3]).suspects()
                    hits = len(np.intersect1d(found.indices, wrong))
                    precision = hits / len(found.indices) if len(found.indices) else math.nan
                    recall = hits / len(wrong) if len(wrong) else math.nan
                    rows[share, name].append((precision, recall, found.share, found.doubtful))
    print("| wrong | matches | precision | recall | suspected | says that it is not to be trusted |")
    print("|---|---|---|---|---|---|")
    for share in SHARES:
        names = sorted({name for _, name in rows})
        groups = [(name, rows[share, name]) for name in names]
        for name, trials in [*groups, ("all", [trial for _, group in groups for trial in group])]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # no share, no precision
                precision, recall, suspected, doubtful = np.nanmean(np.array(trials, dtype=float), axis=0)
            numbers = f"{precision:.2f} | {recall:.2f} | {100 * suspected:.0f} % | {100 * doubtful:.0f} %"
            print(f"| {100 * share:.0f} % | {name} | {numbers} |".replace("nan", ""), flush=True)


if __name__ == "__main__":
    main()
