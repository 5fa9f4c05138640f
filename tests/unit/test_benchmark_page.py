"""The parts of docs/benchmarks.md that programs print: each is named, and what it holds is replaced alone."""

import shlex

import page
import pytest

import mexpress as mx

TEXT = """\
# Speed

<!-- printed by: benches/grid.py local -->
old, 3.5 minutes
<!-- end -->
What it says.

<!-- printed by: benches/grid.py -->
<!-- end -->
"""


def test_a_part_is_replaced_alone():
    text = page.replaced(TEXT, "benches/grid.py", "| \\1 |\n\n")
    assert text == TEXT.replace("grid.py -->\n", "grid.py -->\n\n| \\1 |\n\n")
    assert dict(page.parts(text)) == {
        "benches/grid.py local": "old, 3.5 minutes",
        "benches/grid.py": "| \\1 |",
    }
    assert page.replaced(TEXT, "benches/other.py", "new") == TEXT


def test_what_is_printed_tells_the_command_and_the_machine():
    first, *rest = page.run("-c 'print(6 * 7)'").splitlines()
    assert rest == ["", "42"]
    assert first.startswith("`-c 'print(6 * 7)'`, 20")
    assert page.MINUTES.search(first)[1] == "0.0"
    assert first.endswith(f"mexpress {mx.__version__}.")


def test_a_command_that_fails_leaves_its_part(tmp_path, monkeypatch, capfd):
    text = TEXT.replace("benches/grid.py local", "-c '1/0'").replace("benches/grid.py", "-c 'print(5)'")
    (tmp_path / "page.md").write_text(text)
    monkeypatch.setattr(page, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr("sys.argv", ["page.py"])
    with pytest.raises(SystemExit, match="failed: -c '1/0'"):
        page.main()
    assert "ZeroDivisionError" in capfd.readouterr().err
    found = dict(page.parts((tmp_path / "page.md").read_text()))
    assert found["-c '1/0'"] == "old, 3.5 minutes"
    assert found["-c 'print(5)'"].endswith("\n\n5")
    monkeypatch.setattr("sys.argv", ["page.py", "--list"])
    page.main()
    assert capfd.readouterr().out.splitlines() == [
        "   3.5 minutes  -c '1/0'",
        "   0.0 minutes  -c 'print(5)'",
    ]
    monkeypatch.setattr("sys.argv", ["page.py", "grid"])
    with pytest.raises(SystemExit):
        page.main()
    assert "no command of page.md contains grid" in capfd.readouterr().err


def test_every_part_of_the_page_is_of_a_program_that_exists():
    text = page.PAGE.read_text()
    commands = [command for command, _ in page.parts(text)]
    assert len(commands) == text.count("<!-- printed by:") == text.count("<!-- end -->") > 5
    assert len(set(commands)) == len(commands)
    assert all((page.ROOT / shlex.split(command)[0]).is_file() for command in commands)
