"""The notebook of the examples runs from beginning to end, and shows what a reader is to see."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[2] / "examples" / "selection.ipynb"


@pytest.fixture
def stored():
    return nbformat.read(NOTEBOOK, as_version=4)


def test_it_is_stored_without_what_it_prints(stored):
    nbformat.validate(stored)
    code = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert len(code) > 5
    assert all(cell.execution_count is None and cell.outputs == [] for cell in code)


@pytest.mark.slow
def test_it_runs_and_shows_tables_and_figures(stored):
    NotebookClient(stored, timeout=300, resources={"metadata": {"path": NOTEBOOK.parent}}).execute()
    outputs = {cell.source: cell.outputs for cell in stored.cells if cell.cell_type == "code"}
    every = [output for each in outputs.values() for output in each]
    assert not [output for output in every if output.get("name") == "stderr"]
    shown = [set(output.get("data", {})) for output in every]
    assert sum("text/html" in kinds for kinds in shown) == 3  # two selections and a warp
    assert sum("image/png" in kinds for kinds in shown) == 5
    for source, each in outputs.items():
        assert source.startswith("import numpy") or each, f"nothing is shown by {source}"
    (left_out,) = [output.text for output in every if output.get("text", "").startswith("left out")]
    found, wrong = (line.partition("[")[2] for line in left_out.splitlines())
    assert found == wrong
