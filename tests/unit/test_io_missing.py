import numpy as np
import pytest

from mexpress.cli.common import Parser, add_table
from mexpress.io.missing import Missing


@pytest.mark.parametrize(
    ("given", "values", "drop"),
    [
        (None, (), False),
        (-9999, (-9999,), False),
        (np.int16(-32768), (-32768,), False),
        ("drop", (), True),
        ([-9999, 65535.0], (-9999, 65535), False),
        (("drop", 1e10), (1e10,), True),
        (np.array([0, 1]), (0, 1), False),
    ],
)
def test_what_means_no_data(given, values, drop):
    assert Missing.of(given) == Missing(values, drop)


@pytest.mark.parametrize(
    "given", ["none", ["drop", "none"], np.nan, [np.inf], True, [[1]], {"a": 1}, object()]
)
def test_what_is_refused(given):
    with pytest.raises((ValueError, TypeError), match=r'^Invalid missing\. .*no data, "drop".* Given .*\.$'):
        Missing.of(given)


@pytest.mark.parametrize(
    ("array", "values", "expected"),
    [
        (np.array([1.0, np.nan, np.inf, -9999]), [-9999], [0, 1, 1, 1]),
        (np.array([0, 65535, 7], np.uint16), [65535, -1, 0.5], [0, 1, 0]),
        (np.array([-(2**15), 7], np.int16), [-32768], [1, 0]),
        (np.array([-3.4028234663852886e38, 1.1], np.float32), [-3.4028234663852886e38, 1.1], [1, 1]),
        (np.array([1.1], np.float32), [1e300], [0]),
    ],
)
def test_where_there_are_none(array, values, expected):
    assert Missing.of(values).marks(array).tolist() == [bool(one) for one in expected]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--missing", "-9999,65535"], [-9999, 65535]),
        (["--missing=-9999"], [-9999]),
        (["--missing", "-3.4e38"], [-3.4e38]),
        (["--missing", "Drop,0"], ["drop", 0]),
        ([], None),
    ],
)
def test_the_option(words, expected):
    parser = Parser()
    add_table(parser, "x,y")
    assert parser.parse_args(words).missing == expected


def test_an_option_that_is_refused(capsys):
    parser = Parser()
    add_table(parser, "x,y")
    with pytest.raises(Exception, match="must be numbers that mean no data, such as -9999,65535, or drop"):
        parser.parse_args(["--missing", "none"])
