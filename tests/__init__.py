"""Tests. Those that run side by side have a core each: threads of theirs would only wait for each other's."""

import os

#: Processes that share the cores (pytest-xdist says how many there are).
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
if WORKERS > 1:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of linear algebra, before it is loaded
