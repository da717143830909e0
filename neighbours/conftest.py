"""Fixtures of the neighbours' tests: those of the core's, and their sources on the path of what they start."""

import pytest

from tests.conftest import (
    dataset_folder as dataset_folder,
    echogram as echogram,
    neighbours_installed as neighbours_installed,
    own_cache as own_cache,
    own_cores as own_cores,
    pytest_collection as pytest_collection,
    shared as shared,
    small_scene as small_scene,
)


@pytest.fixture(scope="session", autouse=True)
def sources_on_the_path(neighbours_installed: None) -> None:
    """Tests, and programs that they start, find the neighbours and their entry points, installed or not."""
