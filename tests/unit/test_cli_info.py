"""`mexpress info`, `mexpress suspects`, `--json` and completion."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

import mexpress as mx
from mexpress.cli import completion, main
from mexpress.geometry import lattice
from mexpress.io.matches import write_matches

RNG = np.random.default_rng(1)
SOURCE = RNG.uniform(0, 1, (80, 2)) * [640, 480]
TARGET = 0.9 * SOURCE + 15 * np.sin(SOURCE[:, ::-1] / 150) + RNG.normal(0, 0.3, SOURCE.shape)
WRONG = TARGET.copy()
WRONG[[7, 30]] += [[40, 40], [90, 0]]


def told(run, *arguments):
    status, text, errors = run(*arguments, "--json")
    assert (status, errors) == (0, "")
    return json.loads(text)


# mexpress info


def test_a_warp_is_told(run, tmp_path):
    warp = mx.fit_warp(SOURCE, TARGET, SOURCE[:12], smoothing=2.0)
    warp.save(tmp_path / "warp.npz")
    said = told(run, "info", tmp_path / "warp.npz")
    assert (said["kind"], said["format"], said["mexpress"]) == ("warp", 1, mx.__version__)
    errors = warp.error(lattice(warp.domain, 1000))
    assert said["model"] == {
        "form": repr(warp),
        "lifting": "tps",
        "control_points": 12,
        "smoothing": 2.0,
        "fractional": True,
        "data": 80,
        "domain": [*SOURCE.min(axis=0), *SOURCE.max(axis=0)],
        "error": {
            "median": np.median(errors),
            "largest": errors.max(),
            "covered": said["model"]["error"]["covered"],
        },
    }
    status, text, errors = run("info", tmp_path / "warp.npz")
    assert (status, errors) == (0, "")
    assert text.startswith(f"{tmp_path / 'warp.npz'}: a warp, of mexpress {mx.__version__}\n")
    for line in (
        f"model .* {re.escape(repr(warp))}",
        "data +80",
        r"region +x 2\d.* to 63\d",
        "error .* pixels; tested",
    ):
        assert re.search(line, text)


def test_a_surface_is_told(run, tmp_path):
    mx.fit_surface(SOURCE, TARGET[:, 0], SOURCE[:12]).save(tmp_path / "surface.npz")
    said = told(run, "info", tmp_path / "surface.npz")
    assert said["kind"] == "surface"
    assert "fractional" not in said["model"]
    assert "pixels" not in run("info", tmp_path / "surface.npz")[1]


def test_a_model_without_data_has_no_error(run, tmp_path):
    warp = mx.fit_warp(SOURCE, TARGET, SOURCE[:12])
    mx.Warp(warp.lifting, warp.parameters, warp.domain).save(tmp_path / "bare.npz")
    said = told(run, "info", tmp_path / "bare.npz")["model"]
    assert (said["data"], said["error"]) == (None, None)
    assert "not known without the data" in run("info", tmp_path / "bare.npz")[1]


def test_an_error_that_is_not_known_is_undefined(run, tmp_path):
    square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    mx.fit_surface(square, [0, 2, 2, 5], square).save(
        tmp_path / "few.npz"
    )  # no datum follows from the others
    error = told(run, "info", tmp_path / "few.npz")["model"]["error"]
    assert error == {"median": None, "largest": None, "covered": 0.0}
    assert "median undefined, largest undefined; tested in 0 %" in run("info", tmp_path / "few.npz")[1]


def test_a_file_of_an_older_version_is_told(run, tmp_path):
    warp = mx.fit_warp(SOURCE, TARGET, SOURCE[:12])
    with (tmp_path / "old.npz").open("wb") as file:
        np.savez(file, format="mexpress model", version=1, kind="warp", **warp.to_arrays())
    assert told(run, "info", tmp_path / "old.npz")["mexpress"] is None
    assert "a warp, of mexpress 0.1.0 or older" in run("info", tmp_path / "old.npz")[1]


def test_a_selection_is_told_with_its_table_and_notes(run, tmp_path):
    selection = mx.select_warp(SOURCE, WRONG, image_size=(320, 240), robust=True)
    selection.save(tmp_path / "selection.npz")
    said = told(run, "info", tmp_path / "selection.npz")
    assert said["kind"] == "warp selection"
    assert said["selection"] == json.loads(json.dumps(selection.to_dict()))
    assert said["model"]["form"] == repr(selection.warp)
    status, text, errors = run("info", tmp_path / "selection.npz")
    assert status == 0
    assert "MATCHED selects" in text
    assert "Left out as wrong: 2 of 80; --json says which." in text
    assert "outside of the image of 320 x 240 pixels" in errors


def test_surface_selections_are_told(run, tmp_path):
    selection = mx.select_surface(SOURCE, TARGET[:, 0])
    selection.save(tmp_path / "selection.npz")
    assert told(run, "info", tmp_path / "selection.npz")["model"]["form"] == repr(selection.surface)


@pytest.mark.parametrize("name", ["matches.csv", "none.npz"])
def test_what_is_no_model_is_one_line(run, tmp_path, name):
    write_matches(tmp_path / "matches.csv", SOURCE, TARGET)
    status, text, errors = run("info", tmp_path / name)
    assert (status, text) == (2, "")
    assert errors.startswith("mexpress: error: ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("command", [["info"], ["apply"], ["suspects"]])
@pytest.mark.parametrize("name", [".", "/", "folder"])
def test_a_folder_is_no_file(run, tmp_path, monkeypatch, command, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "p.csv").write_text("x,y\n320,240\n")
    others = ["p.csv"] if command == ["apply"] else []
    assert run(*command, name, *others) == (2, "", f"mexpress: error: {name}: Is a directory\n")


def test_a_selection_is_applied_as_its_model_is(run, tmp_path):
    (tmp_path / "p.csv").write_text("x,y\n320,240\n100,50\n")
    for name, selection in (
        ("warp", mx.select_warp(SOURCE, TARGET)),
        ("surface", mx.select_surface(SOURCE, TARGET[:, 0])),
    ):
        selection.save(tmp_path / "selection.npz")
        getattr(selection, name).save(tmp_path / "model.npz")
        applied = [
            run("apply", tmp_path / file, tmp_path / "p.csv") for file in ("selection.npz", "model.npz")
        ]
        assert applied[0] == applied[1]
        assert applied[0][0] == 0


# mexpress suspects


@pytest.fixture
def wrong(tmp_path):
    write_matches(tmp_path / "matches.csv", SOURCE, WRONG)
    return tmp_path / "matches.csv"


def test_suspects_are_those_of_the_library(run, wrong):
    said = told(run, "suspects", wrong)
    found = mx.select_warp(SOURCE, WRONG).suspects()
    assert [each["match"] for each in said["suspects"]] == found.indices.tolist() == [30, 7]
    np.testing.assert_allclose(said["scores"], found.scores)
    assert said["sigma"] == pytest.approx(found.sigma)
    assert said["suspects"][0]["target"] == pytest.approx(WRONG[30].tolist())
    status, text, errors = run("suspects", wrong, "--quiet")
    assert (status, errors) == (0, "")
    first, _, head, *lines = text.splitlines()
    assert first == "2 of 80 matches look wrong: scores above 6"
    assert head.split() == ["match", "score", "x1", "y1", "x2", "y2"]
    assert [line.split()[0] for line in lines] == ["30", "7"]
    numbers = np.array([line.split()[2:] for line in lines], dtype=float)
    np.testing.assert_allclose(numbers, np.hstack([SOURCE, WRONG])[[30, 7]], rtol=1e-5)


def test_options_of_suspects_are_those_of_the_library(run, wrong):
    said = told(
        run, "suspects", wrong, "--threshold", "3", "--radius", "4", "--no-fractional", "--threads", "1"
    )
    found = mx.select_warp(SOURCE, WRONG, fractional=False).suspects(3, 4)
    assert said["threshold"] == 3
    np.testing.assert_allclose(said["scores"], found.scores)


def test_rows_are_counted_with_those_that_are_missing(run, tmp_path):
    rows = np.hstack([SOURCE, WRONG])
    rows[3] = -9999
    np.savetxt(tmp_path / "m.csv", rows, delimiter=",")
    said = told(run, "suspects", tmp_path / "m.csv", "--missing", "-9999,drop")
    assert [each["match"] for each in said["suspects"]] == [30, 7]
    assert said["scores"][3] is None


def test_no_suspects_are_one_line(run, tmp_path):
    write_matches(tmp_path / "m.csv", SOURCE, TARGET)
    assert run("suspects", tmp_path / "m.csv") == (0, "0 of 80 matches look wrong: scores above 6\n", "")


def test_matches_without_a_score_are_told(run, wrong):
    lost = np.isnan(mx.select_warp(SOURCE, WRONG).suspects(radius=60).scores).sum()
    assert 0 < lost < 80
    status, text, errors = run("suspects", wrong, "--quiet", "--radius", "60")
    assert status == 0
    assert text.startswith(f"2 of {80 - lost} matches look wrong")
    assert errors.startswith(
        f"mexpress: {lost} of 80 matches have no score: those farther away than --radius 60 "
    )
    assert errors.count("\n") == 1
    assert run("suspects", wrong, "--json", "--radius", "60")[2] == errors


def test_matches_of_which_none_has_a_score_are_not_judged(run, wrong):
    status, text, errors = run("suspects", wrong, "--quiet", "--radius", "200")
    assert (status, text) == (0, "no match has a score, so none is judged\n")
    assert errors.startswith("mexpress: 80 of 80 matches have no score")
    said = json.loads(run("suspects", wrong, "--radius", "200", "--json")[1])
    assert (said["suspects"], said["sigma"]) == ([], None)
    assert said["doubt"].startswith("No datum of the fit has a score")


def test_matches_that_are_missing_need_no_score(run, tmp_path):
    rows = np.hstack([SOURCE, TARGET])
    rows[:2] = -9999
    np.savetxt(tmp_path / "m.csv", rows, delimiter=",")
    missing = run("suspects", tmp_path / "m.csv", "--quiet", "--missing", "-9999,drop")
    assert missing == (0, "0 of 78 matches look wrong: scores above 6\n", "")


@pytest.mark.parametrize("option", ["threshold", "radius"])
def test_bad_numbers_of_suspects_are_one_line(run, wrong, option):
    status, text, errors = run("suspects", wrong, f"--{option}", "-1")
    assert (status, text) == (2, "")
    assert errors.startswith(f"mexpress: error: Invalid --{option}. ")


# --json


@pytest.mark.parametrize("command", ["warp", "surface"])
def test_what_is_printed_is_what_is_written(run, tmp_path, command):
    write_matches(tmp_path / "m.csv", SOURCE, TARGET)
    np.savetxt(tmp_path / "xyz.csv", np.column_stack([SOURCE, TARGET[:, 0]]), delimiter=",")
    file = {"warp": "m.csv", "surface": "xyz.csv"}[command]
    status, text, _ = run(command, tmp_path / file, "--no-plots", "--out", tmp_path / "out", "--json")
    assert status == 0
    assert text == (tmp_path / "out" / "selection.json").read_text()
    said = json.loads(text)
    assert "json" not in said["command"]
    assert said["effective_parameters"] > 3


@pytest.mark.slow
def test_an_experiment_prints_what_it_writes(run, tmp_path):
    status, text, _ = run(
        "reproduce", "figure4", "--quick", "--no-plots", "--quiet", "--out", tmp_path, "--json"
    )
    assert status == 0
    assert text == (tmp_path / "figure4.json").read_text()


# Completion


def printed(shell, capsys):
    with pytest.raises(SystemExit) as left:
        main(["--print-completion", shell])
    assert left.value.code in (0, None)
    return capsys.readouterr().out


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_every_shell_has_a_script_with_all_commands(shell, capsys):
    script = printed(shell, capsys)
    for word in ("warp", "surface", "apply", "info", "suspects", "reproduce"):
        assert word in script


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["mexpress", "s"], {"surface", "suspects"}),
        (["mexpress", "warp", "--im"], {"--image-size"}),
        (["mexpress", "info", "mod"], {"model.npz"}),
        (["mexpress", "warp", "--out", "d"], {"directory"}),
    ],
)
def test_bash_completes(typed, offered, tmp_path, capsys):
    (tmp_path / "completion.sh").write_text(printed("bash", capsys))
    (tmp_path / "model.npz").touch()
    (tmp_path / "directory").mkdir()
    (tmp_path / "data.csv").touch()
    program = (
        f"source ./completion.sh; COMP_WORDS=({' '.join(typed)}); COMP_CWORD={len(typed) - 1}; "
        f"_shtab_mexpress mexpress {typed[-1]}; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(["bash", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert {word.strip() for word in done.stdout.splitlines()} == offered


def test_an_unknown_shell_is_one_line(run):
    status, text, errors = run("--print-completion", "dos")
    assert (status, text) == (2, "")
    assert errors.count("\n") == 1


def test_without_shtab_the_extra_is_named(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    status, _, errors = run("--print-completion", "bash")
    assert status == 2
    assert "pip install 'mexpress[completion]'" in errors
