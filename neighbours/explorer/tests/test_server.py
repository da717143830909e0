"""The explorer's server: what it gives is the reader's, and it gives nothing else."""

from __future__ import annotations

import http.client
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from soundspaces_explorer import payloads
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss


@pytest.fixture(scope="module")
def server(dataset_folder: Path) -> Iterator[ExplorerServer]:
    with (
        ss.open_dataset(dataset_folder, 16000) as ds,
        ExplorerServer({"two rooms & <a>": ds}) as running,
    ):
        thread = threading.Thread(target=running.serve_forever, daemon=True)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def _ask(
    server: ExplorerServer, path: str, method: str = "GET", host: str | None = None
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body; `path` as it is."""
    link = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    link.putrequest(method, path, skip_host=True)
    link.putheader("Host", host if host is not None else f"127.0.0.1:{server.server_port}")
    link.endheaders()
    answer = link.getresponse()
    body = answer.read()
    link.close()
    return answer.status, {k.lower(): v for k, v in answer.getheaders()}, body


def _api(server: ExplorerServer, path: str) -> tuple[int, bytes]:
    status, _, body = _ask(server, f"/{server.token}/api/{path}")
    return status, body


NAME = "two%20rooms%20%26%20%3Ca%3E"


def test_the_page_and_what_it_may_load(server: ExplorerServer) -> None:
    for name, kind in (
        ("", "text/html"),
        ("explore.js", "text/javascript"),
        ("explore.css", "text/css"),
    ):
        status, headers, body = _ask(server, urlsplit(server.url).path + name)
        assert status == 200 and headers["content-type"].startswith(kind) and len(body) > 500
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["cache-control"] == "no-store" and "access-control-allow-origin" not in headers
        assert b"http://" not in body and b"https://" not in body  # nothing from elsewhere


def test_responses_are_the_readers(server: ExplorerServer, dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder, 16000) as ds:
        status, body = _api(server, f"{NAME}/response?s=1&l=3&heading=40")
        assert status == 200
        np.testing.assert_array_equal(
            np.frombuffer(body, "<f4").reshape(2, -1), ds.binaural(1, 3, heading_deg=40.0)
        )
        pair = json.loads(_api(server, f"{NAME}/pair?s=1&l=3")[1])
        table = ds.table()
        row = table[(table["source"] == 1) & (table["listener"] == 3)][0]
        for b in range(4):
            late = float(row[f"late_error_{b}"])
            known = pytest.approx(late, abs=1e-4) if np.isfinite(late) else None
            assert pair["error"][1][b] == known
        assert len(pair["arrivals"]) == len(ds[1, 3].arrivals)
        overview = json.loads(_api(server, f"{NAME}/overview")[1])
        np.testing.assert_allclose(overview["points"], ds.points, atol=1e-3)
        level = json.loads(_api(server, f"{NAME}/field?s=1")[1])["level"]
        assert len(level) == len(ds.points) and max(x for x in level if x is not None) == level[1]
    assert json.loads(_api(server, "datasets")[1])["datasets"] == ["two rooms & <a>"]
    sound = np.frombuffer(_api(server, f"{NAME}/sound?name=clap")[1], "<f4")
    assert np.abs(sound).max() == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/", 404), ("/api/datasets", 404), ("//api/datasets", 404), ("/{token}x/", 404), ("/{token}", 200),
        ("/{token}/../../etc/passwd", 404), ("/{token}/%2e%2e/index.html", 404), ("/{token}/index.html", 404),
        ("/{token}/api", 404), ("/{token}/api/none/pair?s=0&l=0", 404), ("/{token}/api/{name}/manifest.json", 404),
        ("/{token}/api/{name}/pair", 400), ("/{token}/api/{name}/pair?s=0", 400),
        ("/{token}/api/{name}/pair?s=0&l=-1", 400), ("/{token}/api/{name}/pair?s=0&l=1e9", 400),
        ("/{token}/api/{name}/pair?s=0&l=99999", 400), ("/{token}/api/{name}/pair?s=%D9%A3&l=0", 400),
        ("/{token}/api/{name}/response?s=0&l=0&heading=nan", 400),
        ("/{token}/api/{name}/response?s=0&l=0&heading=1e300", 400),
        ("/{token}/api/{name}/field?s=0&&", 400), ("/{token}/api/{name}/sound?name=../x", 400),
        ("/{token}/" + "a" * 3000, 414),
    ],
)  # fmt: skip
def test_whatever_else_is_asked(server: ExplorerServer, path: str, status: int) -> None:
    address = path.replace("{token}", server.token).replace("{name}", NAME)
    got, headers, body = _ask(server, address)
    assert got == status
    if status != 200:
        assert headers["content-type"] == "application/json" and set(json.loads(body)) == {"error"}


def test_other_hosts_and_methods(server: ExplorerServer) -> None:
    path = urlsplit(server.url).path
    for host in ("evil.example", f"evil.example:{server.server_port}", "", "127.0.0.1"):
        assert _ask(server, path, host=host)[0] == 403
    assert _ask(server, path, host=f"localhost:{server.server_port}")[0] == 200
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD", "BREW"):
        assert _ask(server, path, method)[0] == 405
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(ss.ConfigError, match=r"--port .*: cannot listen"):
        ExplorerServer({}, server.server_port)


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"GET foo HTTP/1.1", 400), (b"GET * HTTP/1.1", 400), (b"GET http://[ HTTP/1.1", 400),
        (b"GET http://[x]/ HTTP/1.1", 400), (b"GET", 400), (b"\x16\x03\x01\x02", 400), (b"GET / HTTP/1.1 x", 400),
        (b"GET / HTTP/9", 400), (b"GET /" + b"a" * 70000 + b" HTTP/1.1", 414),
    ],
)  # fmt: skip
def test_request_lines_that_are_none(
    server: ExplorerServer, sent: bytes, status: int, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_connection(("127.0.0.1", server.server_port), 10.0) as link:
        link.sendall(
            sent + f"\r\nHost: 127.0.0.1:{server.server_port}\r\nConnection: close\r\n\r\n".encode()
        )
        answer = b""
        with suppress(ConnectionResetError):  # it need not read all that was sent
            while block := link.recv(65536):
                answer += block
    assert f"{status}".encode() in answer.split(b"\n")[0] or f"Error code: {status}".encode() in answer
    assert "Traceback" not in "".join(capfd.readouterr())


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("", 200), ("live.js", 200), ("common.js", 200), ("explore.js", 404), ("index.html", 404),
        ("api/datasets", 404), ("api/none", 404), ("api/job", 404), ("api/scene/x", 404), ("api", 404),
        ("api/scene", 200), ("api/sounds", 200), ("api/forecast", 200), ("api/cut?y=1", 200),
        ("api/cut?y=nan", 400), ("api/sound?name=../x", 400), ("api/sound?name=clap", 200),
        ("api/pair?s=1,1,0&l=4,3,0", 200), ("api/pair?s=1,1,0", 400), ("api/pair?s=1,1,9&l=4,3,0", 400),
        ("api/pair?s=1,1,nan&l=4,3,0", 400), ("api/pair?s=1e9,1,0&l=4,3,0", 400),
        ("api/pair?s=1,1,0&l=40,3,0", 400), ("api/pair?s=1,1,0&l=4,3,0&m=0", 400),
        ("api/pair?s=1,1,0&l=4,3,0&m=99~0.1:0.1:0.1:0.1", 400), ("api/pair?s=1,1,0&l=4,3,0&m=../~1", 400),
        ("api/pair?s=1,1,0&l=4,3,0&m=0~2:2:2:2", 400), ("api/pair?s=1,1,0&l=4,3,0&after=x", 400),
        ("api/response?s=1,1,0&l=4,3,0&heading=inf", 400),
    ],
)  # fmt: skip
def test_what_is_asked_of_a_live_scene(live_server: ExplorerServer, path: str, status: int) -> None:
    got, headers, body = _ask(live_server, f"/{live_server.token}/{path}")
    assert got == status, body
    if status != 200:
        assert headers["content-type"] == "application/json" and set(json.loads(body)) == {"error"}


def test_the_page_of_a_live_scene_is_told_of_its_mesh(live_server: ExplorerServer) -> None:
    """Lines of a box: its walls at the points' height, floor and ceiling in the section; responses are its own."""
    scene = json.loads(_api(live_server, "scene")[1])
    assert {m["name"] for m in scene["materials"]} == {"carpet", "gypsum-board", "acoustic-tile"}
    areas = {m["name"]: m["area"] for m in scene["materials"]}
    assert areas == {"carpet": 30.0, "acoustic-tile": 30.0, "gypsum-board": 66.0}
    lines = np.array(scene["plans"][0])
    length = np.hypot(lines[:, 3] - lines[:, 1], lines[:, 4] - lines[:, 2]).sum()
    assert length == pytest.approx(22.0, abs=0.01)
    cut = np.array(json.loads(_api(live_server, "cut?y=2")[1])["lines"])
    assert np.hypot(cut[:, 3] - cut[:, 1], cut[:, 4] - cut[:, 2]).sum() == pytest.approx(18.0, abs=0.01)
    give_up = time.monotonic() + 120.0
    status = 503
    while status == 503 and time.monotonic() < give_up:  # as the page does, while kernels are compiled
        status, body = _api(live_server, "response?s=1,1,0&l=4,3,0&heading=30")
    assert status == 200, body
    ears = np.frombuffer(body, "<f4").reshape(2, -1)
    assert np.isfinite(ears).all()
    level = np.abs(ears).max(axis=0)
    onset = np.flatnonzero(level > 0.2 * level.max())[0] / 16000
    assert onset == pytest.approx(np.hypot(3.0, 2.0) / 343.0, abs=0.001)


def test_one_request_writes(live_server: ExplorerServer, server: ExplorerServer) -> None:
    """A POST without a body, by this page: not by others, and not of datasets."""
    own = f"127.0.0.1:{live_server.server_port}"
    path = f"/{live_server.token}/api/job?s=1,1,0&l=4,3,0&spacing=5"
    for headers, status in (
        ({"Origin": "http://evil.example"}, 403), ({"Origin": "null"}, 403), ({"Content-Length": "2"}, 400),
        ({"Transfer-Encoding": "chunked"}, 400), ({"Host": "evil.example"}, 403), ({}, 200),
        ({"Origin": f"http://{own}"}, 200),
    ):  # fmt: skip
        link = http.client.HTTPConnection("127.0.0.1", live_server.server_port, timeout=30)
        link.putrequest("POST", path, skip_host=True)
        for name, value in {"Host": own, **headers}.items():
            link.putheader(name, value)
        link.endheaders()
        answer = link.getresponse()
        assert answer.status == status, headers
        answer.read()
        link.close()
    assert _ask(live_server, path.replace("api/job", "api/scene"), "POST")[0] == 404
    assert _ask(live_server, "/x/api/job", "POST")[0] == 404
    assert _ask(live_server, path.replace("spacing=5", "spacing=nan"), "POST")[0] == 400
    assert _ask(server, f"/{server.token}/api/job", "POST")[0] == 405


def test_clients_that_go_away(server: ExplorerServer, capfd: pytest.CaptureFixture[str]) -> None:
    at_once = struct.pack("ii", 1, 0)  # closed by a reset
    for sent in (
        b"",
        b"GET /",
        f"GET /{server.token}/explore.js HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    ):
        for _ in range(5):
            link = socket.create_connection(("127.0.0.1", server.server_port), 10.0)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
            link.sendall(sent)
            link.close()
    assert _ask(server, urlsplit(server.url).path)[0] == 200
    assert "Traceback" not in "".join(capfd.readouterr())


def test_no_number_is_beyond_json(dataset_folder: Path) -> None:
    """NaN and infinity become null."""
    with ss.open_dataset(dataset_folder) as ds:
        json.dumps([payloads.pair(ds, 0, 0), payloads.field(ds, 0)], allow_nan=False)
