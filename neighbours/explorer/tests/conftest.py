"""The explorer's server for tests of its page."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss


@pytest.fixture(scope="module")
def url(dataset_folder: Path) -> Iterator[str]:
    with ss.open_dataset(dataset_folder, 16000) as ds, ExplorerServer({ds.scene: ds}) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()
