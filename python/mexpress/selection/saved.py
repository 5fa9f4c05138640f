"""What a selection is in a file: one text in JSON, and arrays of its data, its models and the user's own schemes.

The text has what was asked and all scores. Numbers are written so that they are read back bit for bit, NaN too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.index_sets import IndexSets
from mexpress.models import FittedModel, Model
from mexpress.schemes import Scheme
from mexpress.selection.data import Data, DataT, part, present
from mexpress.selection.selection import Selection

Arrays = Mapping[str, NDArray[Any]]
FittedT = TypeVar("FittedT", bound=FittedModel)
NumbersT = TypeVar("NumbersT", Integers, Floats)

_OF_DATA = {"points", "values", "weights"}
"""Arrays that all models of a selection share, and that its data have."""


def to_text(content: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return plain values as an array of bytes.

    Examples
    --------
    >>> of_text(to_text({"score": [1.5, float("nan")]}))
    {'score': [1.5, nan]}
    """
    return np.frombuffer(json.dumps(content).encode(), dtype=np.uint8)


def of_text(text: NDArray[Any]) -> dict[str, Any]:
    """Return the plain values of `to_text`.

    Raises
    ------
    ValueError, TypeError
        If it is no such text.
    """
    if text.dtype != np.uint8:
        check.refuse("selection", "It must be bytes.", check.describe(text), TypeError)
    try:
        return mapping(json.loads(text.tobytes()), "selection")
    except RecursionError as error:
        raise ValueError("its text is nested too deeply") from error


def mapping(value: Any, name: str) -> dict[str, Any]:
    """Check that a value is a mapping."""
    if not isinstance(value, dict):
        check.refuse(name, "It must be a mapping.", check.describe(value), TypeError)
    return value


def scores_to_plain(scores: Selection) -> dict[str, Any]:
    """Return the fields of a selection as plain values.

    Examples
    --------
    >>> scores = Selection("FIT", np.array([3]), {"FIT": np.array([1.0])}, {})
    >>> Selection(**scores_of(scores_to_plain(scores), 9))
    Selection(FIT chooses 3 of 3 to 3 control points, FIT=1)
    """
    return {
        "criterion": scores.criterion,
        "counts": scores.counts.tolist(),
        "maps": {name: values.tolist() for name, values in scores.maps.items()},
        "undefined": {
            name: {str(count): data.tolist() for count, data in by_count.items()}
            for name, by_count in scores.undefined.items()
        },
        "weights": scores.weights.tolist(),
        "parameters": None if scores.parameters is None else scores.parameters.tolist(),
        "open": {str(count): unknowns for count, unknowns in scores.open.items()},
        "slack": scores.slack,
        "rivals": {name: scores_to_plain(rival) for name, rival in scores.rivals.items()},
        "rival": scores.rival,
    }


def scores_of(plain: Any, n: int) -> dict[str, Any]:
    """Return the arguments that `Selection` takes, of the plain values of `scores_to_plain` for n data, checked."""
    given = mapping(plain, "scores")
    rule = "They must be whole numbers from 1 on that increase."
    counts = _increasing(check.integers(given["counts"], "counts", rule), "counts", rule, 1)
    rule = "They must be finite numbers from 0 on that increase."
    weights = _increasing(check.real(given["weights"], "weights"), "weights", rule, 0)
    parameters = given["parameters"]
    shape = len(counts), len(weights)
    maps = {name: _grid(scores, name, shape) for name, scores in mapping(given["maps"], "maps").items()}
    rivals = {
        name: Selection(**scores_of(rival, n)) for name, rival in mapping(given["rivals"], "rivals").items()
    }
    criterion, rival = given["criterion"], given["rival"]
    for name, chosen, names in (("criterion", criterion, list(maps)), ("rival", rival, [None, *rivals])):
        if chosen not in names:
            check.refuse(name, f"It must be one of {names}.", check.describe(chosen))
    return {
        "criterion": criterion,
        "counts": counts,
        "maps": maps,
        "undefined": _undefined(given["undefined"], maps, counts, n),
        "weights": weights,
        "parameters": None if parameters is None else _grid(parameters, "parameters", shape),
        "open": {
            count: check.count(number, "open", 0)
            for count, number in _by_count(given["open"], "open", counts).items()
        },
        "slack": check.number(given["slack"], "slack", "It must be a number of at least 0.", 0.0),
        "rivals": rivals,
        "rival": rival,
    }


def _increasing(numbers: NumbersT, name: str, rule: str, low: float) -> NumbersT:
    """Numbers of at least `low`, in a row, of which each is larger than the one before."""
    if numbers.ndim != 1 or not numbers.size:
        check.refuse(name, rule, f"shape {numbers.shape}")
    wrong = ~(np.isfinite(numbers) & (numbers >= low))
    wrong[1:] |= numbers[1:] <= numbers[:-1]
    if wrong.any():
        check.refuse(name, rule, f"{numbers[wrong.argmax()]:g} at {wrong.argmax()}")
    return numbers


def _undefined(
    value: Any, maps: Mapping[str, Any], counts: Integers, n: int
) -> dict[str, dict[int, Integers]]:
    """Return the data that cannot be predicted, by criterion and number of control points."""
    found = {
        name: {
            count: check.indices(lost, "undefined", n)
            for count, lost in _by_count(by, "undefined", counts).items()
        }
        for name, by in mapping(value, "undefined").items()
    }
    for name, by_count in found.items():
        if name not in maps or not by_count:
            rule = "It must have data of criteria that are in the maps, by number of control points."
            check.refuse("undefined", rule, f"{len(by_count)} for {name!r}")
    return found


def _by_count(value: Any, name: str, counts: Integers) -> dict[int, Any]:
    """Return a mapping with numbers of control points, written as texts, as one with the numbers."""
    known = {str(count): count for count in counts.tolist()}
    given = mapping(value, name)
    for key in given.keys() - known.keys():
        check.refuse(name, "Its keys must be numbers of control points that were tried.", check.describe(key))
    return {known[key]: item for key, item in given.items()}


def _grid(values: Any, name: str, shape: tuple[int, int]) -> NDArray[np.float64]:
    grid = check.real(values, name)
    if grid.shape != shape or not grid.size:
        check.refuse(name, f"It must have shape {shape}.", f"shape {grid.shape}")
    return grid


def settings(question: Any) -> dict[str, Any]:
    """Return what was asked, as plain values: the arguments of its `of`, but for threads, which are of a machine.

    A seed that is a generator is none of them either: it cannot be had again.
    """
    values = {name: value for name, value in vars(question).items() if name != "threads"}
    values["lifting"] = question.lifting.name
    if np.asarray(question.seed).dtype.kind not in "iu":
        values["seed"] = None
    return {
        name: value if value is None or isinstance(value, str | bool) else np.asarray(value).tolist()
        for name, value in values.items()
    }


def fields_of(arrays: Arrays, data: Data, ask: Callable[..., Any]) -> dict[str, Any]:
    """Return what every selection for data has besides its models, checked; `ask` returns the question of settings."""
    content, n = of_text(arrays["selection"]), len(data.points)
    return {
        **scores_of(content["scores"], n),
        "data": data,
        "left_out": check.indices(content["left_out"], "left_out", n),
        "searched": check.flag(content["searched"], "searched"),
        "axes": _axes(content["axes"]),
        "question": ask(data, **mapping(content["question"], "question")),
        "schemes": schemes_of(arrays, content["schemes"]),
    }


def _axes(names: Any) -> tuple[str, str] | None:
    """Return what x and y are called, if they were columns."""
    if names is None:
        return None
    rule = "They must be two texts, what x and y are called."
    if not isinstance(names, list) or [type(name) for name in names] != [str, str]:
        check.refuse("axes", rule, check.describe(names))
    return names[0], names[1]


def models_to_arrays(models: Mapping[int, Model]) -> dict[str, NDArray[Any]]:
    """Return the arrays of models by number of control points, without those of the data."""
    return {
        f"model {count}/{name}": array
        for count, model in models.items()
        for name, array in model.to_arrays().items()
        if name not in _OF_DATA
    }


def models_of(arrays: Arrays, kind: type[FittedT], data: DataT, left_out: Integers) -> dict[int, FittedT]:
    """Return the models of `models_to_arrays`, with the data of their fit: those present and not left out."""
    kept = part(data, np.setdiff1d(present(data), left_out))
    shared = {"points": kept.points, "values": kept.values}
    if kept.weights is not None:
        shared["weights"] = kept.weights
    parts: dict[int, dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        model, _, inner = name.partition("/")
        if model.startswith("model "):
            parts.setdefault(int(model.removeprefix("model ")), {})[inner] = array
    return {count: kind.from_arrays({**own, **shared}) for count, own in parts.items()}


def schemes_to_arrays(schemes: Mapping[str, Scheme]) -> dict[str, NDArray[Any]]:
    """Return the arrays of schemes, which are numbered, since a name can be any text."""
    arrays: dict[str, NDArray[Any]] = {}
    for k, scheme in enumerate(schemes.values()):
        for name in ("held_out", "validated"):
            sets = getattr(scheme, name)
            arrays |= {f"scheme {k}/{name} offsets": sets.offsets, f"scheme {k}/{name} indices": sets.indices}
        arrays[f"scheme {k}/order"] = scheme.visiting_order
    return arrays


def schemes_of(arrays: Arrays, sizes: Any) -> dict[str, Scheme]:
    """Return the schemes of `schemes_to_arrays`, given their numbers of data by name."""
    schemes = {}
    for k, (name, n) in enumerate(mapping(sizes, "schemes").items()):
        held_out, validated = (
            IndexSets(arrays[f"scheme {k}/{part} offsets"], arrays[f"scheme {k}/{part} indices"])
            for part in ("held_out", "validated")
        )
        schemes[name] = Scheme(n, held_out, validated, arrays[f"scheme {k}/order"])
    return schemes
