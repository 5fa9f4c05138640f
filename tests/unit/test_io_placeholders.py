"""Constants that seem to mean no data."""

import numpy as np
import pytest

from mexpress.io.placeholders import note_placeholders

RANDOM = np.random.default_rng(0)
DEPTHS = RANDOM.uniform(1500, 1594, 400)
SCENE = RANDOM.uniform(0.4, 8, 400)
COAST = np.maximum(RANDOM.uniform(-300, 900, 3000), 0)
FLOAT32 = np.finfo(np.float32).max


def said(values, dtype=np.float64):
    """The constants that notes name."""
    notes = note_placeholders(np.asarray(values).astype(dtype), "file")
    return [float(note.rpartition("missing=[")[2].removesuffix("].")) for note in notes]


@pytest.mark.parametrize(
    ("values", "dtype", "constant"),
    [
        (DEPTHS, np.float64, -9999),
        (DEPTHS, np.float32, -9999),
        (DEPTHS, np.int16, -32768),
        (DEPTHS, np.uint16, 65535),
        (SCENE, np.float32, -FLOAT32),
        (SCENE, np.float64, 1e10),
        (SCENE, np.float64, 0),
        (SCENE, np.float32, 0),
        (DEPTHS, np.int32, 0),
        (SCENE, np.float64, -1e308),
        (np.full(400, 2.0), np.float64, -9999),
        (COAST - 200, np.float64, -9999),
    ],
)
@pytest.mark.parametrize("times", [1, 3, 300, 4000])
def test_a_constant_far_outside_is_named(values, dtype, constant, times):
    assert said(np.append(values, times * [constant]), dtype) == [float(np.dtype(dtype).type(constant))]


def test_several_constants_are_named():
    assert said(np.concatenate([DEPTHS, [65535] * 9, [-9999] * 3])) == [65535, -9999]


@pytest.mark.parametrize(
    "values",
    [
        DEPTHS,
        SCENE,
        COAST,
        COAST - 200,
        np.arange(100.0),
        np.tile(np.arange(12.0), 9),
        np.tile(np.arange(12), 9),
        np.append(SCENE, 12.0),
        np.append(SCENE, [12.0, 12.0]),
        np.append(RANDOM.normal(size=400), [0] * 9),
        np.append(-SCENE, [0.0]),
        np.full(400, 7.0),
        np.zeros(400),
        np.array([1.0, 2.0, 3.0, 1e10]),
        np.repeat([1.0, 1.25], 200),
        np.repeat([1.0, 3.5], 1200),
        np.repeat([0.0, 50.0], 10),
        np.append(SCENE, SCENE.max() + 20 * np.ptp(SCENE)),
        np.exp(RANDOM.normal(size=400)),
        np.empty(0),
    ],
)
def test_values_that_are_only_spread_are_not(values):
    assert said(values) == []


@pytest.mark.parametrize(
    ("constant", "top"), [(-9999, 500), (-9999, 300), (-32768, 1000), (65535, 1000), (65535, 40000)]
)
@pytest.mark.parametrize("times", [1, 5])
def test_what_stands_for_no_data_in_many_files_need_not_be_as_far(constant, top, times):
    values = RANDOM.uniform(0, top, 2400)
    assert said(np.append(values, times * [constant])) == [constant]


def test_columns_are_looked_at_one_by_one_and_a_constant_is_named_once():
    points = np.column_stack([SCENE, 1000 * SCENE, SCENE])
    points[5:9] = -9999
    assert note_placeholders(points, "cloud.csv") == [
        f"4 of 400 values in cloud.csv are -9999, far from all others, {np.delete(SCENE, range(5, 9)).min():.6g} to "
        f"{np.delete(SCENE, range(5, 9)).max():.6g}: if it means no data, say missing=[-9999]."
    ]


def test_what_is_named_is_exact():
    (note,) = note_placeholders(np.append(SCENE, 2 * [-FLOAT32]).astype(np.float32), "dem.tif")
    assert note.endswith("say missing=[-3.4028234663852886e+38].")
