"""The explorer's server: loopback only, behind a token.

Every address begins with a token of 128 bits, which the command prints; without it, and for whatever is not in the
table below, the answer is 404. Requests must name this machine as host, so that no page elsewhere can reach it by a
name of its own (DNS rebinding), and pages may load nothing but what is served here. Datasets are only read. Of a
scene that is simulated live, one request writes: a POST without a body from this very page, which puts the settings
of a dataset into the folder that the command names.
"""

from __future__ import annotations

import json
import logging
import re
import secrets
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, Protocol
from urllib.parse import parse_qsl, unquote, urlsplit

from soundspaces_explorer import payloads
from soundspaces_explorer.answers import (
    Answered,
    RefusedError,
    floats_answer,
    json_answer,
    number_in,
    sound_answer,
)
from soundspaces_sim import (
    ConfigError,
    MaterialError,
    PairIndexError,
    PointError,
    RirDataset,
    SoundSpacesSimError,
)

_log = logging.getLogger(__name__)
_HTML, _SCRIPT = "text/html; charset=utf-8", "text/javascript; charset=utf-8"
_PAGE = {
    "common.js": ("common.js", _SCRIPT),
    "explore.css": ("explore.css", "text/css; charset=utf-8"),
}
_OF_DATASETS = {"": ("index.html", _HTML), "explore.js": ("explore.js", _SCRIPT)}
_OF_SCENES = {"": ("live.html", _HTML), "live.js": ("live.js", _SCRIPT)}
_LONGEST = 2000  # characters of an address
_NUMBER = re.compile(r"[0-9]{1,7}")
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)


class LiveApi(Protocol):
    """What a live scene answers (`live_api`): the server knows neither it nor the tracer."""

    def answer(self, name: str, query: dict[str, str]) -> Answered:
        """To a question by its name. Raises `RefusedError`."""
        ...

    def change(self, name: str, query: dict[str, str]) -> Answered:
        """To what writes. Raises `RefusedError`."""
        ...


class ExplorerServer(ThreadingHTTPServer):
    """Serves datasets by name, or a live scene, on 127.0.0.1; port 0: a free one. `url` is the page's address."""

    daemon_threads = True

    def __init__(
        self, datasets: Mapping[str, RirDataset], port: int = 0, live: LiveApi | None = None
    ) -> None:
        self.datasets, self.live = datasets, live
        self.page = {**_PAGE, **(_OF_DATASETS if live is None else _OF_SCENES)}
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


class _Handler(BaseHTTPRequestHandler):
    server: ExplorerServer
    server_version, sys_version = "explorer", ""
    protocol_version = "HTTP/1.1"
    timeout = 30

    def do_GET(self) -> None:
        self._respond(self._answer)

    def do_POST(self) -> None:
        self.close_connection = True
        if self.server.live is None:
            self._refuse_method()
        else:
            self._respond(self._change)

    def _respond(self, answer: Callable[[], Answered]) -> None:
        try:
            kind, body = answer()
        except RefusedError as refused:
            self._send(refused.status, "application/json", json.dumps({"error": str(refused)}).encode())
        except (PairIndexError, ConfigError, PointError, MaterialError) as error:
            self._send(HTTPStatus.BAD_REQUEST, "application/json", _message(error))
        except SoundSpacesSimError as error:
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

    def _place(self) -> tuple[list[str], str]:
        """What is asked for behind the token, in parts, and the query."""
        own = {f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")}
        if self.headers.get("Host", "") not in own:
            raise RefusedError(
                HTTPStatus.FORBIDDEN, "the explorer answers requests to this machine only"
            )
        if len(self.path) > _LONGEST:
            raise RefusedError(HTTPStatus.REQUEST_URI_TOO_LONG, "the address is too long")
        try:
            address = urlsplit(self.path)
            _, token, *rest = address.path.split("/")
        except ValueError as error:
            raise RefusedError(HTTPStatus.BAD_REQUEST, "the address cannot be read") from error
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        return rest, address.query

    def _answer(self) -> Answered:
        rest, query = self._place()
        path = "/".join(rest)
        if path in self.server.page:
            name, kind = self.server.page[path]
            return kind, (files("soundspaces_explorer") / "page" / name).read_bytes()
        if not rest or rest[0] != "api":
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        asked = [unquote(part) for part in rest[1:]]
        if self.server.live is None:
            return self._data(asked, _query(query))
        return self.server.live.answer("/".join(asked), _query(query))

    def _change(self) -> Answered:
        """The one request that writes. A page from elsewhere that knew the token would give its own origin."""
        rest, query = self._place()
        assert self.server.live is not None
        if len(rest) != 2 or rest[0] != "api":
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"http://{self.headers['Host']}":
            raise RefusedError(HTTPStatus.FORBIDDEN, "the explorer's own page alone may ask for this")
        if self.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in self.headers:
            raise RefusedError(HTTPStatus.BAD_REQUEST, "expected a request without a body")
        return self.server.live.change(rest[1], _query(query))

    def _data(self, path: list[str], query: dict[str, str]) -> Answered:
        if path == ["datasets"]:
            return json_answer({"datasets": list(self.server.datasets), "sounds": list(payloads.SOUNDS)})
        if len(path) != 2 or path[0] not in self.server.datasets:
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        ds = self.server.datasets[path[0]]
        give = _GIVES.get(path[1])
        if give is None:
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
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


def _query(text: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(text, keep_blank_values=True, strict_parsing=bool(text), max_num_fields=8)
    except ValueError as error:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "the query cannot be read") from error
    return dict(pairs)


def _whole(query: dict[str, str], *names: str) -> list[int]:
    out = []
    for name in names:
        if not _NUMBER.fullmatch(query.get(name, "")):
            raise RefusedError(HTTPStatus.BAD_REQUEST, f"{name}: expected the number of a point")
        out.append(int(query[name]))
    return out


def _pair(ds: RirDataset, query: dict[str, str]) -> Answered:
    s, l = _whole(query, "s", "l")
    payloads.check_pair(ds, s, l)
    return json_answer(payloads.pair(ds, s, l))


def _field(ds: RirDataset, query: dict[str, str]) -> Answered:
    (s,) = _whole(query, "s")
    payloads.check_pair(ds, s)
    return json_answer({"source": s, "level": payloads.field(ds, s)})


def _response(ds: RirDataset, query: dict[str, str]) -> Answered:
    s, l = _whole(query, "s", "l")
    payloads.check_pair(ds, s, l)
    return floats_answer(payloads.response(ds, s, l, number_in(query, "heading", 3600.0, "degrees")))


_GIVES: dict[str, Callable[[RirDataset, dict[str, str]], Answered]] = {
    "overview": lambda ds, _: json_answer(payloads.overview(ds)),
    "pair": _pair,
    "field": _field,
    "response": _response,
    "sound": lambda ds, query: sound_answer(ds.rate, query),
}
