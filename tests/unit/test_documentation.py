"""What README and docs/ show: their Python runs, their commands are understood, and the files that they name exist."""

import argparse
import re
import shlex
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from rasters import png

import mexpress as mx
from mexpress.cli import main
from mexpress.liftings import Lifting

ROOT = Path(__file__).parents[2]
PAGES = {
    str(page.relative_to(ROOT)): page.read_text() for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
}
COMMANDS = [
    pytest.param(shlex.split(line, comments=True)[1:], id=line.split(" #")[0].strip())
    for text in PAGES.values()
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if line.startswith("mexpress ")
]


def code(page):
    """Python of a page, block after block, at the lines where it stands."""
    outside = re.split(r"^```python\n(.*?)^```", PAGES[page], flags=re.DOTALL | re.MULTILINE)
    return "".join(part if turn % 2 else "\n" * (part.count("\n") + 1) for turn, part in enumerate(outside))


def taken_for_granted():
    """Names that pages do not explain in Python."""
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 1, (100, 2)) * [1920, 1080]
    target = source + 20 * np.sin(source / 300) + rng.normal(size=source.shape)
    return {
        "source": source,
        "target": target,
        "problems": [(source, target), (target, source)],
        "confidence": np.linspace(0, 1, len(source)),
        "points": source,
        "A": rng.normal(size=(200, 120)),
        "b": rng.normal(size=200),
        "near": mx.schemes.nearest(np.repeat(source, 2, axis=0), 6),
        "np": np,
        "Lifting": Lifting,
        "cached_property": cached_property,
        "register": lambda lifting: lifting,  # without a trace in other tests
    }


@pytest.mark.parametrize("page", [page for page, text in PAGES.items() if "```python" in text])
def test_python_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    x, y = np.meshgrid(np.arange(24), np.arange(18))
    depth = (5000 + 500 * np.sin(x / 9) + 20 * y).astype(np.uint16)
    (tmp_path / "depth.png").write_bytes(png(depth))
    names = taken_for_granted()
    exec(compile(code(page), ROOT / page, "exec"), names)
    assert names.keys() > taken_for_granted().keys()
    # What a page says that its Python prints is in blocks of text right below it.
    said = re.findall(
        r"^```python\n(?:[^`]|`(?!``))*^```\n\n```text\n(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE
    )
    assert capsys.readouterr().out == "".join(said)


@pytest.mark.parametrize("arguments", COMMANDS)
def test_commands_are_understood(arguments, monkeypatch):
    parsed = []
    parse = argparse.ArgumentParser.parse_args

    def stop(parser, argv):
        parsed.append(parse(parser, argv))
        raise KeyboardInterrupt

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    assert main(arguments) == 130
    assert parsed[0].run


def test_the_reference_has_every_public_name():
    text = "\n".join(text for page, text in PAGES.items() if page.startswith("docs/reference/"))
    shown = set(re.findall(r"^::: (mexpress\.\S+)$", text, re.MULTILINE))
    assert {f"mexpress.{name}" for name in mx.__all__} <= shown
    public = re.search(
        r"modules list in their `__all__`: (.*?)\.$", PAGES["docs/compatibility.md"], re.DOTALL | re.MULTILINE
    )
    modules = set(re.findall(r"`(mexpress\.\w+)`", public[1]))
    assert len(modules) > 6
    assert modules <= shown
    commands = {
        point.name for point in entry_points(group="mexpress.commands") if point.dist.name == "mexpress"
    }
    assert set(re.findall(r"^<!-- mexpress (\w+) --help -->$", text, re.MULTILINE)) == commands


def test_files_that_are_named_exist():
    named = {
        (page, name)
        for page, text in PAGES.items()
        for name in re.findall(r"\b(?:benches|docs|examples|experiments|rust|tests)/[\w/.-]+\.\w+", text)
    }
    links = {
        (page, str(Path(page).parent / name))
        for page, text in PAGES.items()
        for name in re.findall(r"\]\(([\w/.-]+)\)", text)
    }
    assert named
    assert [(page, name) for page, name in sorted(named | links) if not (ROOT / name).exists()] == []
