"""The lifting that docs/liftings.md adds in one file does what is said there."""

import importlib.util
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from test_liftings import scattered

import mexpress as mx
from mexpress.liftings import LIFTINGS, make_lifting

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "fourth_lifting.py"


@pytest.fixture(scope="module")
def fourth():
    spec = importlib.util.spec_from_file_location("fourth_lifting", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["fourth_lifting"] = module  # where pickle looks
    spec.loader.exec_module(module)
    yield module
    del sys.modules["fourth_lifting"], LIFTINGS["cubic"]


def test_the_guide_shows_the_class_as_it_is():
    source = EXAMPLE.read_text()
    code = source.split("# The class in docs/liftings.md\n")[1].split("# The end of the class")[0].strip()
    assert f"```python\n{code}\n```" in (ROOT / "docs" / "liftings.md").read_text()


@pytest.mark.usefixtures("fourth")
@pytest.mark.parametrize("count", [3, 4, 12, 40])
def test_it_interpolates_as_scipy_does(count):
    centres, points = scattered(count) + 1e4, scattered(200, seed=1, size=1500.0) + 1e4
    values = np.random.default_rng(0).normal(size=(count, 2))
    expected = RBFInterpolator(centres - 1e4, values, kernel="cubic", degree=1)(points - 1e4)
    cubic = make_lifting("cubic", centres)
    np.testing.assert_allclose(cubic.basis(points) @ values, expected, rtol=0, atol=1e-8)
    for b, shift in enumerate(1e-2 * np.eye(2)):
        difference = (cubic.basis(points + shift) - cubic.basis(points - shift)) / 2e-2
        np.testing.assert_allclose(cubic.derivatives(points)[..., b], difference, rtol=0, atol=1e-8)
    np.testing.assert_allclose(cubic.basis(points) @ centres, points, rtol=0, atol=1e-7)
    plane = 3 + centres @ [0.5, -2.0]
    assert np.sum((cubic.bending() @ plane) ** 2) < 1e-12 * (1 + np.sum((cubic.bending() @ values) ** 2))


@pytest.mark.usefixtures("fourth")
def test_it_selects_saves_and_loads_by_its_name(tmp_path):
    random = np.random.default_rng(0)
    source = random.uniform(0, 640, (80, 2))
    target = 1.2 * source + 8 * np.sin(source[:, ::-1] / 100) + random.normal(0, 0.5, source.shape)
    selection = mx.select_warp(source, target, "CMPRESS", lifting="cubic", counts=range(3, 20), smoothing=0)
    assert 6 <= selection.count < 20
    warp = selection.warp
    np.testing.assert_allclose(warp.inverse(warp(source)), source, atol=1e-6)
    warp.save(tmp_path / "warp")
    for copy in (mx.load(tmp_path / "warp"), pickle.loads(pickle.dumps(warp))):
        np.testing.assert_array_equal(copy(source), warp(source))
    surface = mx.Surface(warp.lifting, warp.parameters[:, 0], source)
    assert surface.grid(step=40).inside.any()


def test_its_program_prints_how_far_each_lifting_is_from_the_truth(fourth, capsys):
    fourth.main()
    lines = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [line[0] for line in lines] == ["tps", "cubic"]
    assert all(float(line[2]) < 2 for line in lines)
