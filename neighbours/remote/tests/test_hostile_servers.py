"""Datasets at a distance, from servers that answer too much, too little, too slowly or from elsewhere."""

from __future__ import annotations

import gzip
import multiprocessing
import resource
import shutil
import socketserver
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.dataset.reader import RirDataset

pytest.importorskip("aiohttp", reason="aiohttp is not installed")
from soundspaces_remote import remote, web
from yarl import URL

Answer = Callable[["_Handler", bytes, int], None]


class _Server(socketserver.ThreadingTCPServer):
    """Files of a folder; `odd`: how those are answered whose names end so, and how often each was asked for."""

    allow_reuse_address, daemon_threads, block_on_close = True, True, False

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.folder, self.asked = folder, 0
        self.odd: tuple[str, Answer] | None = None
        self.over = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/set"


class _Handler(socketserver.StreamRequestHandler):
    server: _Server

    def handle(self) -> None:
        path = self.rfile.readline().decode().split()[1]
        first = 0
        while line := self.rfile.readline().strip().lower():
            if line.startswith(b"range: bytes="):
                first = int(line.split(b"=")[1].split(b"-")[0])
        name = path.rsplit("/", 1)[1]
        data = (self.server.folder / name).read_bytes()
        odd = self.server.odd
        try:
            if odd is not None and name.endswith(odd[0]):
                self.server.asked += 1
                odd[1](self, data, first)
            else:
                self.head(200, f"Content-Length: {len(data)}")
                self.wfile.write(data)
        except OSError:
            pass  # the reader had enough

    def head(self, status: int, *lines: str) -> None:
        self.wfile.write(
            "\r\n".join([f"HTTP/1.1 {status} X", "Connection: close", *lines, "", ""]).encode()
        )


@pytest.fixture
def server(dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Server]:
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(remote, "_PAUSE_S", 0.001)
    shutil.copytree(dataset_folder, tmp_path / "served")
    with _Server(tmp_path / "served") as running:
        threading.Thread(target=running.serve_forever, args=(0.02,), daemon=True).start()
        yield running
        running.over.set()
        running.shutdown()


def _endless(handler: _Handler, data: bytes, _: int) -> None:
    handler.head(200)
    handler.wfile.write(data)
    while not handler.server.over.is_set():
        handler.wfile.write(b"x" * 65536)


def _bomb(handler: _Handler, _: bytes, __: int) -> None:
    body = gzip.compress(bytes(2**28))
    handler.head(200, "Content-Encoding: gzip", f"Content-Length: {len(body)}")
    handler.wfile.write(body)


def _byte(handler: _Handler, data: bytes, first: int) -> None:
    handler.head(206, f"Content-Range: bytes {first}-{first}/{len(data)}", "Content-Length: 1")
    handler.wfile.write(data[first : first + 1])


def _silent(handler: _Handler, _: bytes, __: int) -> None:
    handler.server.over.wait()


def _dripping(handler: _Handler, _: bytes, __: int) -> None:
    """Headers, a byte at a time."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX: ")
    while not handler.server.over.wait(0.02):
        handler.wfile.write(b"x")


def _elsewhere(handler: _Handler, _: bytes, __: int) -> None:
    port = handler.server.server_address[1]
    handler.head(302, f"Location: http://localhost:{port}/other/manifest.json", "Content-Length: 0")


def _in_circles(handler: _Handler, _: bytes, __: int) -> None:
    handler.head(302, "Location: /set/manifest.json", "Content-Length: 0")


def test_an_endless_manifest(server: _Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "MOST_JSON", 2**22)
    server.odd = "manifest.json", _endless
    with pytest.raises(ss.DatasetError, match=r"manifest\.json: has more than 4,194,304 bytes"):
        ss.open_dataset(server.url)


def test_an_endless_shard_ends_with_what_the_manifest_says(
    server: _Server, dataset_folder: Path
) -> None:
    server.odd = ".h5", _endless
    with ss.open_dataset(server.url) as ds, ss.open_dataset(dataset_folder) as here:
        np.testing.assert_array_equal(ds.echogram(0, 3).energy, here.echogram(0, 3).energy)


def test_nothing_is_decompressed(server: _Server) -> None:
    server.odd = "manifest.json", _bomb
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ss.DatasetError, match="compressed bytes that were not asked for"):
        ss.open_dataset(server.url)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**27 / 1024


def test_a_byte_per_reply_is_asked_for_a_few_times(server: _Server) -> None:
    server.odd = ".h5", _byte
    expected = r"cannot be fetched \(it ends after 5 of [0-9,]+ bytes\)"
    with ss.open_dataset(server.url) as ds, pytest.raises(ss.DatasetError, match=expected):
        ds.echogram(0, 3)
    assert server.asked == remote._TRIES


@pytest.mark.parametrize("odd", [_silent, _dripping], ids=["silent", "a byte of headers at a time"])
def test_a_server_that_does_not_come_to_the_point(
    server: _Server, odd: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "_SILENT_S", 0.2)
    monkeypatch.setattr(remote, "_MANIFEST_S", 0.4)
    monkeypatch.setattr(remote, "_GRACE_S", 0.4)
    monkeypatch.setattr(remote, "_LEAST_RATE", 1e9)
    server.odd = ".h5", odd
    expected = r"cannot be fetched \(.*(imeout|takes more than)"
    with ss.open_dataset(server.url) as ds, pytest.raises(ss.DatasetError, match=expected):
        ds.echogram(0, 3)
    server.odd = "manifest.json", odd
    with pytest.raises(ss.DatasetError, match="cannot be reached"):
        ss.open_dataset(server.url.replace("/set", "/another"))
    with pytest.raises(TimeoutError, match="no time is left"):
        web.Web(server.url).read("manifest.json", 0, 1, -1.0, lambda *_: None)


def test_a_redirect_to_another_host_is_refused_unless_it_is_named(
    server: _Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.odd = "manifest.json", _elsewhere
    with pytest.raises(
        ss.DatasetError, match=r"sends on to http://localhost.*SOUNDSPACES_SIM_REDIRECTS=localhost"
    ):
        ss.open_dataset(server.url)
    assert server.asked == 1
    monkeypatch.setenv("SOUNDSPACES_SIM_REDIRECTS", "example.org, local*")
    with pytest.raises(ss.DatasetError, match="more than 5 redirects"):  # localhost sends to itself
        ss.open_dataset(server.url)
    server.odd = "manifest.json", _in_circles
    with pytest.raises(ss.DatasetError, match="more than 5 redirects"):
        ss.open_dataset(server.url)


@pytest.mark.parametrize(
    ("first", "location", "follows"),
    [
        ("http://a.org/x", "/y", True),
        ("http://a.org/x", "https://a.org/x", True),
        ("https://a.org/x", "http://a.org/x", False),
        ("https://a.org/x", "https://a.org:8443/x", False),
        ("https://a.org/x", "https://b.org/x", False),
        ("https://a.org/x", "https://c.net/x", True),
        ("https://a.org/x", "http://c.net/x", False),
        ("https://a.org/x", "file:///etc/passwd", False),
        ("https://a.org/x", "https://a.org@b.org/x", False),
        ("https://a.org/x", "http://[", False),
    ],
)
def test_where_redirects_may_lead(
    first: str, location: str, follows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(web.ALLOWED, "c.net")
    if follows:
        web._sent_on(URL(first), location)
    else:
        with pytest.raises(ss.DatasetError, match=r"redirect|sends on to"):
            web._sent_on(URL(first), location)


def test_a_manifest_that_is_none_leaves_what_was_fetched(server: _Server) -> None:
    with ss.open_dataset(server.url) as ds:
        expected = ds.echogram(0, 3).energy
    (server.folder / "manifest.json").write_text("<html>please log in</html>")
    with ss.open_dataset(server.url) as ds:
        np.testing.assert_array_equal(ds.echogram(0, 3).energy, expected)


def test_sizes_beyond_the_disk_are_refused_before_anything_is_fetched(
    server: _Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ss.open_dataset(server.url) as ds:
        monkeypatch.setattr(remote.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 5, 5))  # type: ignore[attr-defined]
        server.odd = ".h5", _endless
        with pytest.raises(ss.DatasetError, match=r"are to be fetched, and 5 are free"):
            ds.echogram(0, 3)
    assert server.asked == 0


def _read(ds: RirDataset, out: Any) -> None:
    out.put(float(ds.echogram(0, 3).energy.sum()))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_opened_then_forked(server: _Server, dataset_folder: Path) -> None:
    """As a DataLoader's workers do: opened and read here, then read in forks, at once."""
    fork = multiprocessing.get_context("fork")
    with ss.open_dataset(server.url) as ds, ss.open_dataset(dataset_folder) as here:
        out: Any = fork.Queue()
        workers = [fork.Process(target=_read, args=(ds, out), daemon=True) for _ in range(2)]
        for worker in workers:
            worker.start()
        found = [out.get(timeout=60.0) for _ in workers]
        for worker in workers:
            worker.join(10.0)
        assert found == [float(here.echogram(0, 3).energy.sum())] * 2


def test_a_file_system_of_fsspec(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fsspec

    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path))
    fsspec.filesystem("memory").put(str(dataset_folder), "/sets/one", recursive=True)
    with ss.open_dataset("memory://sets/one") as ds, ss.open_dataset(dataset_folder) as here:
        np.testing.assert_array_equal(ds.echogram(0, 3).energy, here.echogram(0, 3).energy)
    with pytest.raises(ss.ConfigError, match="it is on this machine: give its path"):
        ss.open_dataset(f"file://{dataset_folder}")
