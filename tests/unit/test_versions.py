"""`show_versions` says what a report of a problem needs, on any machine, and imports nothing for it."""

import os
import platform
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest

import mexpress as mx
from mexpress import versions


def shown(capsys):
    """Return what is printed, a value by each name."""
    assert mx.show_versions() is None
    printed = capsys.readouterr()
    assert printed.err == ""
    return dict(line.split(maxsplit=1) for line in printed.out.splitlines())


def test_it_names_the_machine_and_every_optional_library(capsys, monkeypatch):
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", "7")
    entries = shown(capsys)
    assert entries["mexpress"] == mx.__version__
    assert entries["numpy"] == np.__version__
    assert entries["Python"].startswith(platform.python_version())
    assert entries["threads"] == f"7 of {os.cpu_count()} cores"
    assert entries["processor"].startswith(platform.machine())
    assert {name: entries[name] for name in ("distributed", "pillow", "scikit-image", "matplotlib")} == {
        name: version(name) for name in ("distributed", "pillow", "scikit-image", "matplotlib")
    }


def test_a_library_that_is_not_there_is_said_not_to_be(capsys, monkeypatch):
    monkeypatch.setattr(versions, "requires", lambda _: ["numpy>=2", "no.such_one-2>=1 ; extra == 'none'"])
    entries = shown(capsys)
    assert entries["no.such_one-2"] == "not installed"
    assert "matplotlib" not in entries


def test_a_bare_numpy_has_neither_features_nor_a_version_of_blas(capsys, monkeypatch):
    config = {"Build Dependencies": {"blas": {"name": "none"}}, "SIMD Extensions": {}}
    monkeypatch.setattr(np, "show_config", lambda mode: config)
    entries = shown(capsys)
    assert entries["processor"] == platform.machine()
    assert entries["BLAS"] == "none"


def test_a_number_of_threads_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", "many")
    with pytest.raises(ValueError, match=r"Invalid MEXPRESS_NUM_THREADS\."):
        mx.show_versions()


def test_nothing_optional_is_imported():
    program = "import sys, mexpress; mexpress.show_versions(); print(sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    for module in ("distributed", "PIL", "skimage", "matplotlib", "scipy"):
        assert f"'{module}'" not in done.stdout.splitlines()[-1]
