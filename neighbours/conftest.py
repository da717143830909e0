"""Fixtures of the neighbours' tests: those of the core's, and their sources on the path of what they start."""

import os
from pathlib import Path

import pytest

from tests.conftest import dataset_folder as dataset_folder
from tests.conftest import echogram as echogram
from tests.conftest import own_cache as own_cache
from tests.conftest import own_cores as own_cores
from tests.conftest import shared as shared
from tests.conftest import small_scene as small_scene

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session", autouse=True)
def sources_on_the_path() -> None:
    """Programs that a test starts find the neighbours whether or not they are installed."""
    found = [ROOT, *sorted(ROOT.glob("neighbours/*/src"))]
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, found), *([before] if before else [])])
