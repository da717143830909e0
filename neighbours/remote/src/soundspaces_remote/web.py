"""Files of web servers, which may be slow, silent, endless or hostile: what they can cost is bounded.

No more bytes are taken than are asked for, nothing is decompressed, and every read has a deadline, headers
included. A redirect to another host is refused unless SOUNDSPACES_SIM_REDIRECTS names that host. No connection,
thread or event loop outlives a read, so a process may fork at any time between reads.
"""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from typing import Any

import aiohttp
from yarl import URL

from soundspaces_sim import DatasetError

#: Hosts to which redirects are followed, such as ``cdn.example.org,*.example.net``.
ALLOWED = "SOUNDSPACES_SIM_REDIRECTS"
_SILENT_S = 30.0  # without a byte, and until a connection is there
_MOST_REDIRECTS = 5
_REDIRECTS = (301, 302, 303, 307, 308)
_AGAIN = (408, 425, 429)  # beside 500 and above: what may be otherwise the next time
_RANGE = re.compile(r"bytes (\d{1,18})-\d{1,18}/(\d{1,18}|\*)")

Take = Callable[[int, bytes], None]  # place in the file, bytes


class Web:
    """The files below an http or https address."""

    def __init__(self, url: str) -> None:
        self.url = url

    def read(self, name: str, first: int, most: int, seconds: float, take: Take) -> None:
        """Give the bytes from `first` to `most` of a file to `take`, in order; from 0 on where the server knows no
        ranges. Raises `FileNotFoundError`, `DatasetError` for answers that are no use to try again, and whatever a
        network raises."""
        if not seconds > 0.0:  # which aiohttp would take for no limit
            raise TimeoutError("no time is left")
        try:
            _run(_read(URL(f"{self.url}/{name}"), first, most, seconds, take))
        except TimeoutError as error:
            raise TimeoutError(str(error) or f"it takes more than {seconds:.0f} s") from error


def _run(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine to its end, also where a loop runs already (notebooks)."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        asyncio.run(work)
        return
    with ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, work).result()


async def _read(place: URL, first: int, most: int, seconds: float, take: Take) -> None:
    limits = aiohttp.ClientTimeout(total=seconds, sock_connect=_SILENT_S, sock_read=_SILENT_S)
    asked = {"Accept-Encoding": "identity", "Range": f"bytes={first}-{most - 1}"}
    async with aiohttp.ClientSession(
        timeout=limits,
        headers=asked,
        auto_decompress=False,
        trust_env=True,
        cookie_jar=aiohttp.DummyCookieJar(),
    ) as session:
        for _ in range(_MOST_REDIRECTS + 1):
            async with session.get(place, allow_redirects=False) as answer:
                if answer.status in _REDIRECTS:
                    place = _sent_on(place, answer.headers.get("Location", ""))
                    continue
                at = _begins(place, answer, first)
                async for block in answer.content.iter_any():
                    take(at, block[: most - at])
                    at += len(block)
                    if at >= most:
                        return
                return
    raise DatasetError(f"{place}: more than {_MOST_REDIRECTS} redirects")


def _begins(place: URL, answer: aiohttp.ClientResponse, first: int) -> int:
    """The place in the file at which an answer begins."""
    if answer.status in (404, 410):
        raise FileNotFoundError(str(place))
    if answer.status in _AGAIN or answer.status >= 500:
        raise OSError(f"the server answers {answer.status}")
    if answer.status not in (200, 206):
        raise DatasetError(f"{place}: the server answers {answer.status}, not with the file")
    if answer.headers.get("Content-Encoding", "identity").lower() != "identity":
        raise DatasetError(f"{place}: the server answers with compressed bytes that were not asked for")
    if answer.status == 200:
        return 0
    found = _RANGE.fullmatch(answer.headers.get("Content-Range", ""))
    if found is None or int(found[1]) != first:
        raise OSError(f"the server answers with another part of the file than that from byte {first:,}")
    return first


def _sent_on(place: URL, location: str) -> URL:
    """Where a redirect leads. Raises `DatasetError` if that is another host that nobody allowed."""
    try:
        there = place.join(URL(location))
    except ValueError as error:
        raise DatasetError(f"{place}: a redirect that cannot be read") from error
    kept = (there.host, there.port) == (place.host, place.port) and there.scheme == place.scheme
    safer = there.host == place.host and (place.scheme, there.scheme) == ("http", "https")
    host = there.host or ""
    allowed = [x.strip() for x in os.environ.get(ALLOWED, "").split(",") if x.strip()]
    named = there.scheme == "https" or (place.scheme, there.scheme) == ("http", "http")
    if kept or safer or (named and any(fnmatchcase(host, pattern) for pattern in allowed)):
        return there
    raise DatasetError(
        f"{place}: sends on to {there.scheme}://{host[:200]}, which was not asked for; if you trust that host, set "
        f"{ALLOWED}={host[:200]}"
    )
