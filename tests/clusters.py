"""Clusters of processes on this machine, for tests that kill some of them."""

import logging
from contextlib import contextmanager

import pytest


@contextmanager
def client_of(workers):
    """Start so many processes of one thread each, and yield a client of theirs."""
    distributed = pytest.importorskip("distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        yield client
