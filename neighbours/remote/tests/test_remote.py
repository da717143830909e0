"""Datasets at a distance, from a server on this machine that does what servers do."""

from __future__ import annotations

import pickle
import shutil
import threading
import time
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss

pytest.importorskip("aiohttp", reason="aiohttp is not installed")


class _Server(ThreadingHTTPServer):
    """Files of a folder, with ranges. `breaks`: requests that end half-way; `wrong`: files whose bytes are damaged,
    so many times; `pause`: seconds before each answer; `asked`: paths of files, in order."""

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.folder = folder
        self.breaks = 0
        self.wrong: dict[str, int] = {}
        self.pause = 0.0
        self.asked: list[str] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/data/set"


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_HEAD(self) -> None:
        self._answer(False)

    def do_GET(self) -> None:
        self._answer(True)

    def _answer(self, body: bool) -> None:
        server, name = self.server, self.path.removeprefix("/data/set/")
        path = server.folder / name
        time.sleep(server.pause)
        if not path.is_file():
            self.send_error(404)
            return
        data = bytearray(path.read_bytes())
        if body:
            server.asked.append(name)
            if server.wrong.get(name, 0) > 0:
                server.wrong[name] -= 1
                data[len(data) // 2] ^= 1
        size, first, last = len(data), 0, len(data) - 1
        wanted = self.headers.get("Range", "")
        if wanted.startswith("bytes="):
            low, _, high = wanted.removeprefix("bytes=").partition("-")
            first, last = int(low), min(int(high or last), last)
        self.send_response(206 if wanted else 200)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(max(last - first + 1, 0)))
        if wanted:
            self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
        self.end_headers()
        if not body:
            return
        part = bytes(data[first : last + 1])
        if server.breaks > 0 and name.endswith(".h5"):
            server.breaks -= 1
            part = part[: len(part) // 2]
        self.wfile.write(part)
        self.close_connection = True

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def server(dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Server]:
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path / "cache"))
    copy = tmp_path / "served"
    shutil.copytree(dataset_folder, copy)
    with _Server(copy) as running:
        thread = threading.Thread(target=partial(running.serve_forever, poll_interval=0.02), daemon=True)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def _shards(server: _Server) -> list[str]:
    return [name for name in server.asked if name.endswith(".h5")]


def test_what_is_read_is_fetched_once(server: _Server, dataset_folder: Path) -> None:
    with ss.open_dataset(server.url) as ds, ss.open_dataset(dataset_folder) as here:
        assert _shards(server) == [] and ds.scene == here.scene
        np.testing.assert_array_equal(ds.binaural(0, 3), here.binaural(0, 3))
        fetched = len(_shards(server))
        assert fetched >= 1
        ds.binaural(0, 3)
        again = pickle.loads(pickle.dumps(ds))
        np.testing.assert_array_equal(again.binaural(0, 3), here.binaural(0, 3))
        assert len(_shards(server)) == fetched
        assert len(ds.table(collocated=True)) == len(here)  # all shards
        assert ss.verify_dataset(ds.path, full=True)[1] == []


def test_a_connection_that_breaks_off_is_gone_on_with(server: _Server, dataset_folder: Path) -> None:
    server.breaks, server.pause = 3, 0.05
    with ss.open_dataset(server.url) as ds, ss.open_dataset(dataset_folder) as here:
        np.testing.assert_array_equal(ds.binaural(0, 3), here.binaural(0, 3))


def test_an_interrupted_fetch_keeps_what_it_has(server: _Server, dataset_folder: Path) -> None:
    with ss.open_dataset(server.url) as ds:
        name = ds._stored.shards._locate("echogram", 0, 3)[0].file
        data = (server.folder / name).read_bytes()
        (ds.path / f".{name}.part").write_bytes(data[: len(data) // 2])  # of a process that was killed
        (server.folder / name).write_bytes(b"x" * (len(data) // 2) + data[len(data) // 2 :])
        with ss.open_dataset(dataset_folder) as here:
            np.testing.assert_array_equal(ds.binaural(0, 3), here.binaural(0, 3))


def test_a_wrong_byte_on_the_way_and_one_at_its_source(server: _Server) -> None:
    with ss.open_dataset(server.url) as ds:
        name = ds._stored.shards._locate("echogram", 0, 3)[0].file
        server.wrong[name] = 1
        ds.echogram(0, 3)  # fetched once more
        (ds.path / name).unlink()
        ds.close()
        server.wrong[name] = 100
        with pytest.raises(
            ss.DatasetError, match=r"is not what the manifest says \(its SHA-256 differs\)"
        ):
            ds.echogram(0, 3)
        assert not (ds.path / name).exists()


def test_offline_what_was_fetched_is_read(server: _Server, caplog: pytest.LogCaptureFixture) -> None:
    url = server.url
    with ss.open_dataset(url) as ds:
        expected = ds.binaural(0, 3)
    server.shutdown()
    server.server_close()
    with ss.open_dataset(url) as ds:
        assert "cannot be reached" in caplog.text
        np.testing.assert_array_equal(ds.binaural(0, 3), expected)
    with pytest.raises(ss.DatasetError, match="cannot be reached"):
        ss.open_dataset(url + "2")


def test_other_content_at_the_same_address(
    server: _Server, small_scene: ss.Scene, tmp_path: Path
) -> None:
    from tests.conftest import small_job

    with ss.open_dataset(server.url) as ds:
        ds.echogram(0, 3)
    other = ss.build_dataset(small_scene, tmp_path / "other", small_job(seed=5)).folder
    shutil.rmtree(server.folder)
    shutil.copytree(other, server.folder)
    with ss.open_dataset(server.url) as ds, ss.open_dataset(other) as here:
        np.testing.assert_array_equal(ds.echogram(0, 3).energy, here.echogram(0, 3).energy)


def test_what_is_not_there(server: _Server) -> None:
    with pytest.raises(ss.DatasetError, match=r"no dataset at http.*manifest\.json is missing"):
        ss.open_dataset(server.url.replace("/set", "/none"))
    with pytest.raises(ss.ConfigError, match="nowhere://x: cannot be read here"):
        ss.open_dataset("nowhere://x")
