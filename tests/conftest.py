"""How much is tried, by how many threads, and which tests are of the paper."""

import logging
import os

import pytest
from hypothesis import HealthCheck, settings

# Matrices are small here: threads of numpy's BLAS would take twice the time, most of it to wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# At the level INFO, which pytest sets, every selection would compute its notes.
logging.getLogger("mexpress").setLevel(logging.WARNING)

UNHURRIED = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
REPEATABLE = UNHURRIED | {"derandomize": True, "database": None}
settings.register_profile("fast", max_examples=10, **REPEATABLE)
settings.register_profile("ci", max_examples=200, **REPEATABLE)
settings.register_profile("nightly", max_examples=2000, derandomize=False, print_blob=True, **UNHURRIED)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name == "paper":  # the folder of tests, and the examples of the package's
            item.add_marker(pytest.mark.paper)


@pytest.fixture
def run(capsys):
    """Run the command line: its exit status, and what it prints."""
    from mexpress.cli import main  # noqa: PLC0415 - numpy reads the number of threads when it is imported

    def run(*arguments):
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run
