"""What is loaded does what was saved, and nothing else is taken for it."""

import copy
import json
import math

import numpy as np
import pandas as pd
import pytest
from inputs import refused

import mexpress as mx
from mexpress.selection import saved

RNG = np.random.default_rng(3)
SOURCE = RNG.uniform(0, 1, (60, 2)) * [640, 480]
TARGET = 0.9 * SOURCE + 15 * np.sin(SOURCE[:, ::-1] / 150) + RNG.normal(0, 0.3, SOURCE.shape)
WRONG = TARGET.copy()
WRONG[[7, 30]] += 60
GAPS = TARGET.copy()
GAPS[5, 1] = np.nan
WEIGHTS = RNG.uniform(0.5, 2, 60)
WEIGHTS[11] = 0
DEPTH = TARGET[:, 0] / 100
NEAR = mx.schemes.exclusion_radius(SOURCE, 60)
PAPER = {"smoothing": 0, "counts": range(3, 9)}

MADE = {
    "warp": lambda: mx.select_warp(SOURCE, TARGET),
    "everything given": lambda: mx.select_warp(
        SOURCE,
        WRONG,
        criterion="ER05",
        criteria=["NN50PTS"],
        smoothing=[1.0, 10.0],
        counts=[3, 12, 50],
        image_size=(640, 480),
        weights=WEIGHTS,
        robust=True,
        seed=np.int64(4),
        threads=1,
    ),
    "rows that are missing": lambda: mx.select_warp(SOURCE, GAPS, missing="drop", **PAPER),
    "queries far away": lambda: mx.select_warp(SOURCE, TARGET, queries=(600, 400, 2000, 1000)),
    "all over the image": lambda: mx.select_warp(SOURCE, TARGET, queries="image", image_size=(2000, 900)),
    "an affine map": lambda: mx.select_warp(SOURCE, SOURCE + RNG.normal(size=SOURCE.shape)),
    "no perspective": lambda: mx.select_warp(SOURCE, TARGET, fractional=False, lifting="bspline", **PAPER),
    "a scheme of one's own": lambda: mx.select_warp(SOURCE, TARGET, "near/..", {"near/..": NEAR}, **PAPER),
    "a generator": lambda: mx.select_warp(SOURCE, TARGET, "KF05", seed=np.random.default_rng(0), **PAPER),
    "surface": lambda: mx.select_surface(SOURCE, DEPTH),
    "columns that are called": lambda: mx.select_surface(pd.DataFrame(SOURCE, columns=["lon", "lat"]), DEPTH),
    "points in space": lambda: mx.select_surface(
        SOURCE, np.column_stack([TARGET, DEPTH]), queries=SOURCE[:9]
    ),
    "the paper's surface": lambda: mx.select_surface(
        SOURCE, DEPTH, smoothing=0, max_count=20, min_distance=30.0, weights=WEIGHTS
    ),
    "wrong depths": lambda: mx.select_surface(SOURCE, WRONG[:, 0], lifting="affine", robust=True),
}


def model_of(selection):
    return selection.warp if isinstance(selection, mx.WarpSelection) else selection.surface


def same_data(one, other):
    assert (one is None) == (other is None)
    if one is not None:
        np.testing.assert_array_equal(one, other, strict=True)


@pytest.fixture(params=MADE)
def pair(request, tmp_path):
    """Return a selection, and what is loaded after it was saved."""
    live = MADE[request.param]()
    live.save(tmp_path / "selection.npz")
    return live, mx.load(tmp_path / "selection.npz")


def test_what_is_loaded_is_what_was_saved(pair):
    live, loaded = pair
    assert type(loaded) is type(live)
    assert repr(loaded) == repr(live)
    assert loaded.to_dict() == live.to_dict()  # with notes, which are computed anew
    for name in live.maps:
        np.testing.assert_array_equal(loaded.maps[name], live.maps[name], strict=True)
    for name in ("counts", "weights", "parameters", "left_out", "kept"):
        same_data(getattr(loaded, name), getattr(live, name))
    for name in ("axes", "slack", "open", "searched", "placement", "selected_rival", "score"):
        assert getattr(loaded, name) == getattr(live, name)
    same_data(loaded.data.points, live.data.points)
    same_data(loaded.data.values, live.data.values)
    same_data(loaded.data.weights, live.data.weights)
    assert loaded.data.image_size == live.data.image_size
    assert list(loaded.rivals) == list(live.rivals)


def test_its_models_are_what_they_were(pair):
    live, loaded = pair
    assert loaded._models.keys() == live._models.keys()
    for count, model in live._models.items():
        other = loaded._models[count]
        np.testing.assert_array_equal(other(SOURCE), model(SOURCE))
        assert other.smoothing == model.smoothing
        assert other.data.over_data == model.data.over_data
        for name in ("points", "values", "weights"):
            same_data(getattr(other.data, name), getattr(model.data, name))
    np.testing.assert_array_equal(model_of(loaded).error(SOURCE), model_of(live).error(SOURCE))
    if isinstance(live, mx.SurfaceSelection):
        same_data(loaded.control_points, live.control_points)


def test_it_computes_what_the_live_one_computes(pair):
    live, loaded = pair
    np.testing.assert_array_equal(loaded.radii([0, 5]).scores, live.radii([0, 5]).scores)
    if not isinstance(live.question.seed, np.random.Generator):
        np.testing.assert_array_equal(loaded.suspects().scores, live.suspects().scores)
    some = np.setdiff1d(live.kept, live.kept[:4])
    assert loaded.again(some).criterion == live.criterion


def test_a_copy_of_a_copy_is_the_same(pair):
    live, loaded = pair
    first, second = live.to_arrays(), loaded.to_arrays()
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(second[name], array, strict=True)


def test_all_models_of_a_selection_share_its_data(tmp_path):
    live = mx.select_warp(SOURCE, TARGET, **PAPER)
    live.save(tmp_path / "a")
    loaded = mx.load(tmp_path / "a")
    assert len(loaded.warps) > 2
    assert all(warp.data.points is loaded.data.points for warp in loaded.warps.values())
    assert not any(name.endswith(("/points", "/values")) for name in live.to_arrays())


# Hostile files


@pytest.mark.parametrize("path", [None, 3, "", [], b""])
def test_a_path_that_is_none_is_refused(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    selection = mx.select_warp(SOURCE, TARGET, **PAPER)
    for call in (lambda: selection.save(path), lambda: mx.load(path)):
        refused(call, "path")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def arrays():
    selection = mx.select_warp(SOURCE, TARGET, "near", {"near": NEAR}, robust=True)
    return {
        "format": np.array("mexpress model"),
        "version": np.array(1),
        "kind": np.array("warp selection"),
        **selection.to_arrays(),
    }


def read(path, arrays):
    with path.open("wb") as file:
        np.savez(file, **arrays)
    return mx.load(path)


def refused_file(path, arrays):
    with pytest.raises(ValueError, match=r"^Invalid path\. It must name a saved model or selection\. Given "):
        read(path, arrays)


def test_the_file_itself_is_read(arrays, tmp_path):
    assert isinstance(read(tmp_path / "a", arrays), mx.WarpSelection)


def test_a_file_without_one_of_its_arrays_is_refused(arrays, tmp_path):
    models = {name.partition("/")[0] for name in arrays if name.startswith("model ")}
    assert len(models) == 2
    for name in arrays:
        fewer = {other: array for other, array in arrays.items() if other != name}
        if name.endswith(("/smoothing", "/over_data", "_curve")) or name not in {"weights", "image_size"}:
            refused_file(tmp_path / "a", fewer)


@pytest.mark.parametrize(
    "junk", [np.array(3.5), np.array("text"), np.zeros((0, 2)), np.full((60, 2), np.nan)]
)
def test_a_file_with_a_wrong_array_is_refused_or_read(junk, arrays, tmp_path):
    for name in arrays:
        try:
            read(tmp_path / "a", {**arrays, name: junk})
        except ValueError as error:
            assert str(error).startswith("Invalid path.")  # noqa: PT017
        else:
            assert name.endswith(("over_data", "smoothing", "version"))


def leaves(value, path=()):
    """Yield the places of all values in nested ones."""
    yield path
    items = value.items() if isinstance(value, dict) else ()
    for key, item in (*items, *(enumerate(value[:2]) if isinstance(value, list) else ())):
        yield from leaves(item, (*path, key))


def put(content, path, junk):
    *inner, last = path
    place = content
    for key in inner:
        place = place[key]
    place[last] = junk


@pytest.mark.parametrize("junk", [None, -1, 1e400, "text", [], {}, [[1]], True, {"a": {"b": 1}}, math.nan])
def test_a_text_with_a_wrong_value_is_refused_or_read(junk, arrays, tmp_path):
    content = json.loads(arrays["selection"].tobytes())
    places = [path for path in leaves(content) if path]
    assert len(places) > 50
    refusals = 0
    for path in places:
        changed = copy.deepcopy(content)
        put(changed, path, junk)
        try:
            loaded = read(tmp_path / "a", {**arrays, "selection": saved.to_text(changed)})
        except ValueError as error:
            assert str(error).startswith("Invalid path.")  # noqa: PT017
            refusals += 1
        else:
            assert loaded.count in loaded.warps
    assert refusals > 20


@pytest.mark.parametrize("name", ["criterion", "rival"])
def test_what_is_selected_must_be_there(name, arrays, tmp_path):
    content = json.loads(arrays["selection"].tobytes())
    (rival,) = content["scores"]["rivals"].values()
    for scores in (content["scores"], rival):
        changed = {**scores, name: "mine"}
        whole = changed if scores is not rival else {**content["scores"], "rivals": {"affine map": changed}}
        text = saved.to_text({**content, "scores": whole})
        with pytest.raises(
            ValueError, match=rf"cannot be rebuilt: Invalid {name}\. It must be one of .* 'mine'"
        ):
            read(tmp_path / "a", {**arrays, "selection": text})


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("scores", "weights", 0), -1.0, r"Invalid weights\. .* Given -1 at 0"),
        (("scores", "weights", 1), 1.0, r"Invalid weights\. .* increase\. Given 1 at 1"),
        (("scores", "weights", 2), math.nan, r"Invalid weights\. .* finite .* Given nan at 2"),
        (("scores", "counts"), [60, 60], r"Invalid counts\. .* increase\. Given 60 at 1"),
        (("scores", "counts"), [60, 3], r"Invalid counts\. .* increase\. Given 3 at 1"),
        (("scores", "counts"), [-3, 60], r"Invalid counts\. .* Given -3 at 0"),
        (("scores", "rivals", "affine map", "weights"), [-1.0], r"Invalid weights\. .* Given -1 at 0"),
        (("axes",), ["x"], r"Invalid axes\. They must be two texts, what x and y are called\. Given \['x'\]"),
        (("axes",), ["x", "y", "z"], r"Invalid axes\. They must be two texts"),
        (("axes",), [None, "y"], r"Invalid axes\. They must be two texts"),
        (("axes",), {"a": 1, "b": 2}, r"Invalid axes\. They must be two texts"),
        (("scores", "undefined"), {"near": {"few": [1]}}, r"Invalid undefined\. Its keys .* Given 'few'"),
        (("scores", "undefined"), {"near": {"12": [1]}}, r"Invalid undefined\. Its keys .* Given '12'"),
        (("scores", "undefined"), {"near": [1]}, r"Invalid undefined\. It must be a mapping\. Given \[1\]"),
        (("scores", "undefined"), {"near": {}}, r"Invalid undefined\. .* Given 0 for 'near'"),
        (("scores", "undefined"), {"ER07": {"3": [1]}}, r"Invalid undefined\. .* in the maps.* for 'ER07'"),
        (("scores", "undefined"), {"near": {"3": [60]}}, r"Invalid undefined\. Indices must be .* Given 60"),
        (("scores", "open"), {"few": 1}, r"Invalid open\. Its keys .* Given 'few'"),
    ],
)
def test_what_is_wrong_in_a_text_is_told(path, value, message, arrays, tmp_path):
    content = json.loads(arrays["selection"].tobytes())
    put(content, path, value)
    with pytest.raises(ValueError, match=rf"^Invalid path\. .* cannot be rebuilt: {message}"):
        read(tmp_path / "a", {**arrays, "selection": saved.to_text(content)})


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b"\xff", b"[" * 100_000, b'"text"', b"null"])
def test_a_text_that_is_none_is_refused(text, arrays, tmp_path):
    refused_file(tmp_path / "a", {**arrays, "selection": np.frombuffer(text, dtype=np.uint8)})


def test_a_selection_of_a_later_version_is_refused(arrays, tmp_path):
    with pytest.raises(
        ValueError, match="a warp selection of format 2; this version of mexpress reads up to 1"
    ):
        read(tmp_path / "a", {**arrays, "version": np.array(2)})
