import numpy as np
import pytest
from inputs import refused

import mexpress as mx
from mexpress.models.nested_errors import nested_errors

RNG = np.random.default_rng(1)
POINTS, UNSEEN = RNG.uniform(0, 100, (400, 2)), RNG.uniform(-5, 105, (5000, 2))


def wave(points):
    return np.sin(points / 20) + points[:, :1] * points[:, 1:] / 3000


@pytest.mark.parametrize("wanted", [slice(None), slice(0, 1), 0])
def test_errors_are_those_of_surfaces_that_are_fitted_one_by_one(wanted):
    values = (wave(POINTS) + RNG.normal(0, 0.1, POINTS.shape))[:, wanted]
    truth, control_points = wave(UNSEEN)[:, wanted], POINTS[::13]
    errors = nested_errors(POINTS, values, control_points, UNSEEN, truth)
    assert len(errors) == len(control_points) - 2
    for count in (3, 4, 17, len(control_points)):
        surface = mx.fit_surface(POINTS, values, control_points[:count])
        residuals = (surface(UNSEEN) - truth).reshape(len(UNSEEN), -1)
        assert errors[count - 3] == pytest.approx(np.sqrt((residuals**2).sum(axis=1).mean()), rel=1e-8)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("values", {"values": POINTS[:9]}),
        ("unseen", {"unseen": np.zeros((0, 2))}),
        ("truth", {"truth": UNSEEN[:9]}),
        ("truth", {"truth": UNSEEN[:, 0]}),
        ("control_points", {"control_points": POINTS[:2]}),
    ],
)
def test_what_does_not_fit_is_refused(name, change):
    data = {
        "points": POINTS,
        "values": POINTS,
        "control_points": POINTS[:9],
        "unseen": UNSEEN,
        "truth": UNSEEN,
    }
    refused(lambda: nested_errors(**data | change), name, ValueError)
