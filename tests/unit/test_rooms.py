"""The picture of docs/architecture.md shows the code as it is: after a change of who imports whom, `make rooms`."""

import importlib.util
from pathlib import Path

import pytest
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def rooms():
    spec = importlib.util.spec_from_file_location("rooms", DOCS / "rooms.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_has_the_arrows_of_the_code(rooms):
    with Image.open(DOCS / "rooms.png") as picture:
        assert picture.info["Description"] == rooms.described(rooms.read_arrows())


def test_no_arrow_runs_upward(rooms):
    arrows = rooms.read_arrows()
    assert len(arrows) > 10
    for pair, late in arrows.items():
        importing, imported = (rooms.ROOMS[name] for name in pair)
        assert importing.row > imported.row or late, pair


def test_it_is_drawn_anew(rooms, tmp_path):
    rooms.draw(tmp_path / "rooms.png")
    with Image.open(tmp_path / "rooms.png") as new, Image.open(DOCS / "rooms.png") as old:
        assert new.info["Description"] == old.info["Description"]
