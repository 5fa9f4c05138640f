"""The demo of warps runs, and its table and README say the same."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_page_is_flattened(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location("demo_warp", ROOT / "examples" / "demo_warp.py")
    demo = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(demo)
    demo.run()
    table = capsys.readouterr().out.split("vanishes  warp")[1]
    medians = {
        name: float(median) for median, name in re.findall(r"^ +([\d.]+) .* %  (.*)$", table, re.MULTILINE)
    }
    auto, paper = (next(medians[name] for name in medians if word in name) for word in ("auto", "ER10"))
    assert auto < paper < 2
    said = "The selected warp is {:.1f} pixels off in the median, a homography {:.0f};"
    assert said.format(auto, medians["a homography"]) in (ROOT / "README.md").read_text()
    assert (demo.OUT / "flattened.png").stat().st_size > 100_000
