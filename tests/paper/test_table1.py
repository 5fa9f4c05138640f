"""Table 1, figures 2 and 3: the machinery, and the paper's claims on a quick run."""

import argparse
import csv
import io
import json
import math
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import mexpress as mx
from mexpress import simulation
from mexpress.cli import main
from mexpress.paper import EXPERIMENTS, Experiment, Options, Outcome, command, table1
from mexpress.paper.plot_table1 import plot_mean_curves, plot_selections
from mexpress.paper.published import CRITERIA, PUBLISHED, SIZES, Cell
from mexpress.paper.table1_cells import Comparison, Curves, compared, fit_scale, table
from mexpress.paper.table1_claims import claims

# ---------------------------------------------------------------------------------------- the paper's numbers


def test_the_paper_s_table_is_whole():
    assert list(PUBLISHED) == ["TEST", *CRITERIA]
    assert len(CRITERIA) == 13
    assert all(list(cells) == list(SIZES) for cells in PUBLISHED.values())
    missing = [(name, n) for name, cells in PUBLISHED.items() for n in SIZES if math.isnan(cells[n].count)]
    assert missing == [("NN10PTS", 15), ("NN10PTS", 30)]
    assert PUBLISHED["TEST"][15] == Cell(5.5, 1.3, 42.5, 28.4)
    assert PUBLISHED["ER05"][500] == Cell(75.0, 12.8, 2.7, 0.9)
    assert PUBLISHED["NN10PCT"][150] == Cell(10.8, 3.3, 34.0, 17.9)
    # Sums over the columns, as a check of every digit.
    known = [cell for cells in PUBLISHED.values() for cell in cells.values() if not math.isnan(cell.count)]
    assert sum(cell.count for cell in known) == pytest.approx(1667.4)
    assert sum(cell.fit for cell in known) == pytest.approx(1344.0)
    assert sum(cell.count_std for cell in known) == pytest.approx(249.1)
    assert sum(cell.fit_std for cell in known) == pytest.approx(755.5)


# ------------------------------------------------------------------------------------------------- selections


def test_cells_are_means_and_deviations_of_what_is_selected():
    rng = np.random.default_rng(0)
    counts = np.arange(3, 9)
    values = {
        "FIT": rng.uniform(1, 9, (20, 6)),
        "ER10": rng.uniform(1, 9, (20, 6)),
        "NN": np.full((20, 6), np.nan),
    }
    values["ER10"][4] = np.nan  # a problem without a score
    values["ER10"][7, :3] = np.nan
    curves = Curves(counts, values)
    expected = [
        (counts[int(np.nanargmin(score))], fit[int(np.nanargmin(score))])
        for score, fit in zip(values["ER10"], values["FIT"], strict=True)
        if not np.isnan(score).all()
    ]
    (count, fit), cell = np.transpose(expected), curves.cell("ER10")
    assert len(count) == 19
    assert cell == Cell(count.mean(), count.std(), fit.mean(), fit.std())
    assert math.isnan(curves.cell("NN").count)
    mean, deviation = curves.mean("ER10")
    np.testing.assert_allclose(mean, np.nanmean(values["ER10"], axis=0), rtol=1e-12)
    np.testing.assert_allclose(deviation, np.nanstd(values["ER10"], axis=0), rtol=1e-12)
    assert np.isnan(curves.mean("NN")).all()
    values["ER10"][:11, 0] = np.nan  # of more than half
    mean = curves.mean("ER10")[0]
    assert np.isnan(mean).tolist() == [True] + [False] * 5
    assert curves.lowest("ER10") == counts[1:][mean[1:].argmin()]
    assert curves.lowest("NN") is None


@pytest.mark.parametrize(
    ("count", "fit", "within"),
    [
        (23.9, 14.9, (True, True)),
        (31.5, 8.1, (True, True)),
        (31.7, 7.9, (False, False)),
        (16.1, 21.9, (False, False)),
    ],
)
def test_within_means_one_standard_deviation_of_the_paper(count, fit, within):
    paper = PUBLISHED["ER10"][500]  # 23.9 ± 7.7, 14.9 ± 6.9
    comparison = Comparison("ER10", 500, Cell(count, 1.0, fit, 1.0), paper)
    assert comparison.within == within
    assert table([comparison]).count("!") == 2 - sum(within)


def test_fit_is_compared_up_to_one_factor_which_the_row_test_alone_decides():
    curves = paper_like()
    ours = np.array([curves[n].cell("TEST").fit for n in SIZES])
    paper = np.array([PUBLISHED["TEST"][n].fit for n in SIZES])
    root = 1 / np.array([PUBLISHED["TEST"][n].fit_std for n in SIZES])
    expected = np.linalg.lstsq((root * ours)[:, None], root * paper, rcond=None)[0][0]
    assert fit_scale(curves) == pytest.approx(expected, rel=1e-12)
    tenfold = {n: Curves(of.counts, of.values | {"FIT": 10 * of.values["FIT"]}) for n, of in curves.items()}
    assert fit_scale(tenfold) == pytest.approx(expected / 10, rel=1e-12)
    for one, other in zip(compared(curves), compared(tenfold), strict=True):
        assert one.within == other.within
        assert one.ours.fit == pytest.approx(other.ours.fit)
        assert one.ours.count == other.ours.count
    changed = {n: Curves(of.counts, of.values | {"ER10": -of.values["ER10"]}) for n, of in curves.items()}
    assert fit_scale(changed) == fit_scale(curves)


def synthetic(counts_of):
    """Curves of which each criterion selects a given number, FIT falling."""
    curves = {}
    for n in SIZES:
        counts = np.arange(3, mx.selection.largest_count(n) + 1)
        fit = 100.0 / counts[None] + np.zeros((2, 1))
        values = {
            name: (counts - np.round(cells[n].count)) ** 2.0 + np.ones((2, 1))
            for name, cells in counts_of.items()
        }
        curves[n] = Curves(counts, values | {"FIT": fit})
    return curves


def paper_like(**other):
    """The paper's cells, NaN as three, some changed."""
    cells = {
        name: {n: Cell(3.0, 0, 0, 0) if math.isnan(c.count) else c for n, c in of.items()}
        for name, of in PUBLISHED.items()
    }
    for name, numbers in other.items():
        cells[name] = {n: Cell(number, 0, 0, 0) for n, number in zip(SIZES, numbers, strict=True)}
    return synthetic(cells)


def test_the_paper_s_own_numbers_hold_every_claim():
    judged = claims(paper_like())
    assert [claim.holds for claim in judged] == [True] * 5
    assert all(claim.text.startswith("holds: ") for claim in judged)


@pytest.mark.parametrize(
    ("which", "other"),
    [
        (0, {"PRESS": (5, 10, 46, 40), "CMPRESS": (5, 10, 46, 40)}),
        (0, {"CMPRESS": (5, 10, 30, 97)}),
        (0, {"PRESS": (5, 10, 46, 75), "CMPRESS": (5, 10, 46, 75), "TEST": (5, 11, 50, 75)}),
        (0, {"PRESS": (5, 10, 46, 91), "CMPRESS": (5, 10, 46, 91), "TEST": (5, 11, 50, 99)}),
        (1, {"KF10": (5, 10, 50, 100)}),
        (1, {"KF05": (3, 4, 10, 20)}),
        (2, {"ER10": (4, 8, 17, 60)}),
        (2, {"ER05": (5, 9, 35, 95)}),
        (3, {"NN05PTS": (5, 10, 24, 83)}),
        (3, {"NN02PTS": (4, 8, 24, 60)}),
    ],
)
def test_a_claim_can_fail(which, other):
    assert not claims(paper_like(**other))[which].holds


def test_a_fit_with_a_minimum_is_told():
    curves = paper_like()
    curves[150].values["FIT"][:, 40:] = 9.0
    judged = claims(curves)[4]
    assert not judged.holds
    assert judged.text.startswith("does NOT hold: FIT alone")


def test_a_fit_that_rises_on_the_way_is_told():
    curves = paper_like()
    curves[150].values["FIT"][:, 40] *= 1.05
    assert not claims(curves)[4].holds


def test_undefined_values_of_fit_are_told():
    curves = paper_like()
    curves[150].values["FIT"][0, 40:43] = math.nan
    judged = claims(curves)[4]
    assert judged.holds
    assert "undefined 3 times" in judged.text
    curves[150].values["FIT"][:] = math.nan
    assert not claims(curves)[4].holds


def test_the_numbers_of_a_claim_are_those_of_a_full_run():
    curves = paper_like()
    some = Curves(curves[500].counts[::8], {name: of[:, ::8] for name, of in curves[500].values.items()})
    assert some.counts[-1] == 99
    assert "of the 100 that are allowed" in claims(curves | {500: some})[0].claim


# ---------------------------------------------------------------------------------------------------- measuring


def test_one_problem_is_measured_as_its_definition_says():
    configuration = simulation.Configuration(2, 5, 3)
    rows = table1.measure(configuration, 30, stride=4, seed=7)
    matches = simulation.correspondences(configuration, 30, table1._NOISE, 7, table1._SETTING)
    names = ["FIT", *CRITERIA]
    selection = mx.select_warp(
        matches.source,
        matches.target,
        "FIT",
        names,
        counts=[3, 7, 11, 15],
        image_size=(1920, 1080),
        seed=7,
        smoothing=0,
    )
    assert [row[:5] for row in rows] == [(2, 5, 3, 30, count) for count in (3, 7, 11, 15)]
    for k, name in enumerate(names):
        np.testing.assert_allclose([row[5 + k] for row in rows], selection.curves[name], rtol=1e-9)
    for row, warp in zip(rows, selection.warps.values(), strict=True):
        # The algebraic error is the transfer error times the denominator, beyond the horizon too.
        away = warp._map(matches.dense_source) - matches.dense_target
        error = np.hypot(*away.T) * warp.denominator(matches.dense_source)
        assert row[-1] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-9)


def test_a_full_run_has_the_paper_s_1800_problems():
    tasks, quick = (
        [(configuration, n) for configuration, sizes in table1._tasks(quick) for n in sizes]
        for quick in (False, True)
    )
    assert len(tasks) == len(set(tasks)) == 1800
    assert {n for _, n in tasks} == set(SIZES)
    assert set(quick) < set(tasks)
    for n in SIZES:
        sheets = {sheet for c, size in quick for sheet in (c.source, c.target) if size == n}
        assert len(sheets) >= (8 if n == 500 else 10)


def forget(out, which):
    """Leave a database as a run would that was interrupted before some of its tasks."""
    with closing(sqlite3.connect(out / "table1-curves.sqlite")) as connection, connection:
        assert connection.execute(f"DELETE FROM rows WHERE {which}").rowcount > 0


def test_a_configuration_is_one_task_whose_sizes_are_records_of_their_own(tmp_path, monkeypatch):
    some = [(simulation.Configuration(0, 1, 0), (30, 15)), (simulation.Configuration(4, 2, 3), (30, 15))]
    monkeypatch.setattr(table1, "_tasks", lambda _: some)
    monkeypatch.setattr(table1, "SIZES", (15, 30))
    handed = []

    def record(function, problems, **options):
        handed.append(list(problems))
        return mx.map_problems(function, problems, **options)

    monkeypatch.setattr(table1, "map_problems", record)
    options = Options(None, tmp_path, quick=True, seed=3, threads=1, progress=False)
    table1._computed(options)
    rows = tmp_path / "table1-curves.csv"
    whole = rows.read_bytes()
    forget(tmp_path, "source = 4 AND target = 2 AND view = 3 AND n = 15")
    curves = table1._computed(options)
    assert rows.read_bytes() == whole
    assert [[(task[0], dict(task[1])) for task in tasks] for tasks in handed] == [
        [(configuration, {30: 1, 15: 1}) for configuration, _ in some],
        [(some[1][0], {15: 1})],
    ]
    for n in (15, 30):
        expected = [[row[5] for row in table1.measure(c, n, seed=3)] for c, _ in some]
        np.testing.assert_array_equal(curves[n].values["FIT"], expected)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A directory with the quick run of table 1, and what was printed."""
    out = tmp_path_factory.mktemp("table1")
    done = subprocess.run(
        [sys.executable, "-m", "mexpress", "reproduce", "table1", "--quick", "--out", out],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    (out / "printed.txt").write_text(done.stdout)
    return out


def summary(out, name="table1"):
    return json.loads((out / f"{name}.json").read_text())


def test_the_paper_s_claims_hold_on_a_quick_run(out):
    found = summary(out)
    print((out / "printed.txt").read_text())
    assert [claim["claim"] for claim in found["claims"] if not claim["holds"]] == []
    assert len(found["claims"]) == 5


def test_most_cells_of_a_quick_run_agree_with_the_paper(out):
    found = summary(out)["agreement"]
    assert found["all"]["cells"] == 108
    assert found["the 13 criteria"]["cells"] == 100
    # Eight problems at n = 500 make uncertain means; the whole run is to have 95 %.
    assert found["all"]["within"] >= 0.85 * 108
    assert found["the 13 criteria"]["within"] >= 85


def test_files_and_text_tell_the_same(out):
    found, printed = summary(out), (out / "printed.txt").read_text()
    with (out / "table1.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found["cells"]) == 56
    for row, cell in zip(rows, found["cells"], strict=True):
        assert (row["criterion"], int(row["n"])) == (cell["criterion"], cell["n"])
        assert float(row["count"]) == cell["ours"]["count"]
        assert float(row["fit_std"]) == cell["ours"]["fit_std"]
        assert row["count_within"] == ("" if cell["within"][0] is None else str(int(cell["within"][0])))
        assert f"{cell['ours']['count']:.1f} ± {cell['ours']['count_std']:.1f}" in printed
    assert found["command"] == {
        "experiment": "table1",
        "data": None,
        "out": str(out),
        "quick": True,
        "seed": 0,
        "threads": None,
    }
    assert found["versions"]["mexpress"] == mx.__version__
    assert f"{found['agreement']['all']['within']} of 108 cells" in printed


def test_a_quick_run_says_what_its_rows_say(out):
    with (out / "table1-curves.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    chosen = {}
    for row in rows:
        if row["n"] == "150":
            chosen.setdefault((row["source"], row["target"], row["view"]), []).append(row)
    best = [min(of, key=lambda row: float(row["ER10"])) for of in chosen.values()]
    (cell,) = (c for c in summary(out)["cells"] if (c["criterion"], c["n"]) == ("ER10", 150))
    assert len(chosen) == summary(out)["problems"]["150"]
    assert cell["ours"]["count"] == pytest.approx(np.mean([int(row["count"]) for row in best]), rel=1e-12)
    fits = summary(out)["fit_scale"] * np.array([float(row["FIT"]) for row in best])
    assert cell["ours"]["fit"] == pytest.approx(fits.mean(), rel=1e-12)


def test_figures_only_draw_what_table1_computed(out, monkeypatch, capsys):
    monkeypatch.setattr(table1, "measure", lambda *_, **__: pytest.fail("measured again"))
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", "1")  # or it would be pickled
    before = (out / "table1-curves.csv").read_bytes()
    for name in ("figure2", "figure3"):
        assert main(["reproduce", name, "--quick", "--quiet", "--out", str(out)]) == 0
        assert f"{name}.png" in capsys.readouterr().out
        image = imread(out / f"{name}.png")
        assert image.shape[1] > 1000
        assert image[..., :3].std() > 0.02
    assert (out / "table1-curves.csv").read_bytes() == before
    lowest = summary(out, "figure2")["lowest_mean"]
    assert lowest["FIT"] == {"15": 7, "30": 15, "150": 75, "500": 99}
    assert lowest["ER10"]["500"] < lowest["CMPRESS"]["500"]


def test_an_interrupted_run_continues(out, tmp_path, monkeypatch):
    whole = (out / "table1-curves.csv").read_bytes()
    for ending in ("csv", "sqlite"):
        shutil.copy(out / f"table1-curves.{ending}", tmp_path)
    forget(tmp_path, "n = 15 AND source > 0")
    measured = []

    def record(*task, seed):
        measured.append(task)
        return measure(*task, seed=seed)

    measure = table1.measure
    monkeypatch.setattr(table1, "measure", record)
    options = Options(None, tmp_path, quick=True, threads=1, progress=False, plots=False)
    outcome = EXPERIMENTS["table1"].run(options)
    assert {n for _, n, _ in measured} == {15}
    assert all(configuration.source > 0 for configuration, _, _ in measured)
    assert (tmp_path / "table1-curves.csv").read_bytes() == whole
    assert outcome.report + "\n" == (out / "printed.txt").read_text().split(f"\n{out}")[0]


def test_a_run_of_another_kind_in_the_same_directory_is_refused(out, capsys):
    for option in (["--seed", "1", "--quick"], []):
        assert main(["reproduce", "figure2", "--out", str(out), *option]) == 2
        assert "which is of another run" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------------ figures


def test_mean_curves_are_drawn_where_they_are():
    curves = paper_like()
    figure = plot_mean_curves(curves)
    assert len(figure.axes) == 16
    row = figure.axes[12:]  # of n = 500
    drawn = {line.get_label(): line for axes in row for line in axes.lines if line.get_label()[0] != "_"}
    assert set(drawn) == {"FIT", "TEST", *CRITERIA}
    np.testing.assert_array_equal(drawn["ER10"].get_ydata(), curves[500].mean("ER10")[0])
    dots = [line.get_xdata() for line in row[1].lines if line.get_marker() == "o"]
    assert [24] in [list(np.ravel(x)) for x in dots]


def test_bands_of_figure_2_end_at_the_smallest_mean_and_above_zero():
    curves = paper_like()
    curves[500].values["ER10"][1, :9] *= 9.5  # a deviation of 0.81 of the mean
    axes = plot_mean_curves(curves).axes[13]
    places = {
        line.get_label(): k for k, line in enumerate(li for li in axes.lines if li.get_label()[0] != "_")
    }
    band = axes.collections[places["ER10"]].get_paths()
    xs = np.concatenate([path.vertices[:, 0] for path in band])
    assert (xs.min(), xs.max()) == (12, 24)
    for collection in axes.collections:
        for path in collection.get_paths():
            assert path.vertices[:, 1].min() > 0


def test_ticks_of_figure_2_are_plain_numbers():
    figure = plot_mean_curves(paper_like())
    figure.draw_without_rendering()
    for axes in figure.axes[::4]:
        texts = [label.get_text() for label in axes.get_yticklabels(which="both")]
        assert sum(bool(text) for text in texts) >= 2
        assert all(re.fullmatch(r"[\d.]*", text) for text in texts), texts


def few():
    """Curves of four problems, most of which lack a criterion at n = 15."""
    rng = np.random.default_rng(0)
    curves = {n: Curves(np.arange(3, 6), {}) for n in SIZES}
    for of in curves.values():
        of.values.update({name: rng.uniform(1, 9, (4, 3)) for name in ("FIT", *CRITERIA, "TEST")})
    curves[15].values["NN10PTS"][:3] = np.nan
    return curves


def test_figure_2_s_numbers_are_a_table_too(tmp_path, monkeypatch, capsys):
    curves = few()
    monkeypatch.setattr(table1, "_computed", lambda _: curves)
    assert main(["reproduce", "figure2", "--quiet", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"^NN10PTS +- +[345]", printed, re.MULTILINE), printed
    assert "figure2.json, table1-curves.csv, figure2.csv, figure2.png" in printed
    assert json.loads((tmp_path / "figure2.json").read_text())["lowest_mean"]["NN10PTS"]["15"] is None
    with (tmp_path / "figure2.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["n", "count", "criterion", "mean", "std"]
    assert len(rows) == 4 * 3 * 15
    for row in rows:
        mean, std = curves[int(row["n"])].mean(row["criterion"])
        k = int(row["count"]) - 3
        np.testing.assert_array_equal([float(row["mean"]), float(row["std"])], [mean[k], std[k]])


def test_selections_are_drawn_beside_the_paper_s():
    figure = plot_selections(compared(paper_like()))
    assert len(figure.axes) == 8
    ours, paper = (container.lines[0].get_xdata() for container in figure.axes[3].containers)
    np.testing.assert_allclose(paper, [cells[500].count for cells in PUBLISHED.values()])
    np.testing.assert_allclose(ours[1:], np.round(paper[1:]))


# ------------------------------------------------------------------------------------------------- command line


def test_every_experiment_has_its_own_help(capsys):
    assert list(EXPERIMENTS)[:3] == ["table1", "figure2", "figure3"]
    with pytest.raises(SystemExit):
        main(["reproduce", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "table1 and table2, if interrupted, continue" in text
    for name, experiment in EXPERIMENTS.items():
        assert name == experiment.name
        with pytest.raises(SystemExit) as ended:
            main(["reproduce", name, "--help"])
        assert ended.value.code == 0
        assert "--quick" in capsys.readouterr().out


@pytest.fixture
def trial(monkeypatch):
    """An experiment that remembers its options."""
    seen = []

    def run(options):
        seen.append(options)
        summary = {"answer": 42, "unknown": {"a": [math.nan, (1.5, math.inf)], "b": np.float64("nan")}}
        plots = {"good.png": lambda path: path.write_bytes(b""), "bad.png": lambda path: 1 / 0}
        return Outcome("a report", summary, ["rows.csv"], plots)

    experiments = {
        name: Experiment(name, "tries", data, run)
        for name, data in (("plain", ""), ("dir", "DIR"), ("file", "FILE"))
    }
    monkeypatch.setattr("mexpress.paper.command.EXPERIMENTS", experiments)
    return seen


def test_the_command_hands_on_its_options(trial, tmp_path, capsys):
    out = tmp_path / "made" / "here"
    options = ["--out", str(out), "--seed", "5", "--threads", "3", "--quiet", "--no-plots"]
    assert main(["reproduce", "dir", str(tmp_path), *options]) == 0
    assert trial == [Options(tmp_path, out, False, 5, 3, False, False)]
    assert capsys.readouterr().out == f"a report\n\n{out}: dir.json, rows.csv\n"
    written = json.loads((out / "dir.json").read_text())
    assert written["answer"] == 42
    assert written["unknown"] == {"a": [None, [1.5, None]], "b": None}
    assert written["command"]["data"] == str(tmp_path)
    assert main(["reproduce", "dir", "--out", str(out), "--quick"]) == 0
    assert trial[1] == Options(None, out, quick=True)


def test_a_plot_that_fails_costs_nothing_else(trial, tmp_path, capsys):
    assert main(["reproduce", "plain", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"a report\n\n{tmp_path}: plain.json, rows.csv, good.png\n"
    assert "no bad.png. ZeroDivisionError: division by zero" in printed.err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["good.png", "plain.json"]


def test_a_reader_that_has_seen_enough_costs_no_file(trial, tmp_path, monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", Closed())
    arguments = argparse.Namespace(
        data=None, out=tmp_path, quick=False, seed=0, threads=None, quiet=True, plots=True, json=False
    )
    with pytest.raises(BrokenPipeError):
        command._run(command.EXPERIMENTS["plain"], arguments)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["good.png", "plain.json"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing", "--out", "x"], "invalid choice"),
        (["plain"], "--out"),
        (["plain", "data", "--out", "x"], "unrecognized"),
        (
            ["plain", "--out", "x", "--threads", "0"],
            "--threads: must be a whole number of at least 1",
        ),
        (["plain", "--out", "x", "--seed", "-1"], "--seed: must be a whole number of at least 0"),
        (["file", "absent.npy", "--out", "x"], "absent.npy: No such file"),
        (["file", ".", "--out", "x"], "FILE must be a file, but . is a directory"),
        (["dir", __file__, "--out", "x"], "DIR must be a directory"),
    ],
)
def test_wrong_arguments_are_one_line(trial, arguments, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", *arguments]) == 2
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.count("\n") == 1
    assert not Path("x").exists()
    assert trial == []
