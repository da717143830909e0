"""The explorer's server: loopback only, read-only, behind a token.

Every address begins with a token of 128 bits, which the command prints; without it, and for whatever is not in the
table below, the answer is 404. Requests must name this machine as host, so that no page elsewhere can reach it by a
name of its own (DNS rebinding), and pages may load nothing but what is served here. Nothing is written.
"""

from __future__ import annotations

import json
import logging
import math
import re
import secrets
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from soundspaces_explorer import payloads
from soundspaces_sim import (
    ConfigError,
    DatasetError,
    PairIndexError,
    RirDataset,
)

_log = logging.getLogger(__name__)
_PAGE = {
    "": ("index.html", "text/html; charset=utf-8"),
    "explore.js": ("explore.js", "text/javascript; charset=utf-8"),
    "explore.css": ("explore.css", "text/css; charset=utf-8"),
}
_LONGEST = 2000  # characters of an address
_NUMBER = re.compile(r"[0-9]{1,7}")
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)


class ExplorerServer(ThreadingHTTPServer):
    """Serves datasets by name on 127.0.0.1; port 0 takes a free one. `url` is the page's address."""

    daemon_threads = True

    def __init__(self, datasets: Mapping[str, RirDataset], port: int = 0) -> None:
        self.datasets = datasets
        self.token = secrets.token_urlsafe(16)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise ConfigError(
                f"--port {port}: cannot listen on 127.0.0.1 ({error.strerror}); choose another, or 0 for a free one"
            ) from error

    def handle_error(self, _request: Any, _client_address: Any) -> None:
        """A client that goes away is no error; anything else is logged, and the server goes on."""
        error = sys.exception()
        if isinstance(error, OSError):
            _log.debug("a connection ended: %s", error)
        else:
            _log.error("a request failed: %r", error)
            _log.debug("where:", exc_info=error)

    @cached_property
    def url(self) -> str:
        """http://127.0.0.1:port/token/"""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"


class _RefusedError(Exception):
    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    server: ExplorerServer
    server_version, sys_version = "explorer", ""
    protocol_version = "HTTP/1.1"
    timeout = 30

    def do_GET(self) -> None:
        try:
            kind, body = self._answer()
        except _RefusedError as refused:
            self._send(refused.status, "application/json", json.dumps({"error": str(refused)}).encode())
        except (PairIndexError, ConfigError) as error:
            self._send(HTTPStatus.BAD_REQUEST, "application/json", _message(error))
        except DatasetError as error:
            _log.error("%s", error)
            self._send(HTTPStatus.UNPROCESSABLE_ENTITY, "application/json", _message(error))
        else:
            self._send(HTTPStatus.OK, kind, body)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("do_"):  # any other method
            return self._refuse_method
        raise AttributeError(name)

    def _refuse_method(self) -> None:
        self.close_connection = True
        self._send(HTTPStatus.METHOD_NOT_ALLOWED, "application/json", b'{"error": "only GET"}')

    def _answer(self) -> tuple[str, bytes]:
        own = {f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")}
        if self.headers.get("Host", "") not in own:
            raise _RefusedError(
                HTTPStatus.FORBIDDEN, "the explorer answers requests to this machine only"
            )
        if len(self.path) > _LONGEST:
            raise _RefusedError(HTTPStatus.REQUEST_URI_TOO_LONG, "the address is too long")
        try:
            address = urlsplit(self.path)
            _, token, *rest = address.path.split("/")
        except ValueError as error:
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "the address cannot be read") from error
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            raise _RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        path = "/".join(rest)
        if path in _PAGE:
            name, kind = _PAGE[path]
            return kind, (files("soundspaces_explorer") / "page" / name).read_bytes()
        if rest[0] != "api":
            raise _RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        return self._data([unquote(part) for part in rest[1:]], _query(address.query))

    def _data(self, path: list[str], query: dict[str, str]) -> tuple[str, bytes]:
        if path == ["datasets"]:
            return _json({"datasets": list(self.server.datasets), "sounds": list(payloads.SOUNDS)})
        if len(path) != 2 or path[0] not in self.server.datasets:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        ds = self.server.datasets[path[0]]
        give = _GIVES.get(path[1])
        if give is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        return give(ds, query)

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, _: str, *args: Any) -> None:
        _log.debug("request: %r", args)


def _message(error: Exception) -> bytes:
    return json.dumps({"error": str(error)}).encode()


def _json(content: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(content, allow_nan=False, separators=(",", ":")).encode()


def _query(text: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(text, keep_blank_values=True, strict_parsing=bool(text), max_num_fields=8)
    except ValueError as error:
        raise _RefusedError(HTTPStatus.BAD_REQUEST, "the query cannot be read") from error
    return dict(pairs)


def _whole(query: dict[str, str], *names: str) -> list[int]:
    out = []
    for name in names:
        if not _NUMBER.fullmatch(query.get(name, "")):
            raise _RefusedError(HTTPStatus.BAD_REQUEST, f"{name}: expected the number of a point")
        out.append(int(query[name]))
    return out


def _pair(ds: RirDataset, query: dict[str, str]) -> tuple[str, bytes]:
    s, l = _whole(query, "s", "l")
    payloads.check_pair(ds, s, l)
    return _json(payloads.pair(ds, s, l))


def _field(ds: RirDataset, query: dict[str, str]) -> tuple[str, bytes]:
    (s,) = _whole(query, "s")
    payloads.check_pair(ds, s)
    return _json({"source": s, "level": payloads.field(ds, s)})


def _response(ds: RirDataset, query: dict[str, str]) -> tuple[str, bytes]:
    s, l = _whole(query, "s", "l")
    payloads.check_pair(ds, s, l)
    try:
        heading = float(query.get("heading", "0"))
    except ValueError:
        heading = math.nan
    if not -3600.0 <= heading <= 3600.0:
        raise _RefusedError(HTTPStatus.BAD_REQUEST, "heading: expected degrees")
    return _floats(payloads.response(ds, s, l, heading))


def _sound(ds: RirDataset, query: dict[str, str]) -> tuple[str, bytes]:
    if query.get("name") not in payloads.SOUNDS:
        raise _RefusedError(
            HTTPStatus.BAD_REQUEST, f"name: expected one of {', '.join(payloads.SOUNDS)}"
        )
    return _floats(payloads.sound(query["name"], ds.rate))


def _floats(values: Any) -> tuple[str, bytes]:
    return "application/octet-stream", values.astype("<f4").tobytes()


_GIVES: dict[str, Callable[[RirDataset, dict[str, str]], tuple[str, bytes]]] = {
    "overview": lambda ds, _: _json(payloads.overview(ds)),
    "pair": _pair,
    "field": _field,
    "response": _response,
    "sound": _sound,
}
