"""Firefox by WebDriver BiDi (W3C), the protocol that it speaks itself: no driver has to be there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

FIREFOX = os.environ.get("FIREFOX") or shutil.which("firefox") or shutil.which("firefox-esr")
_LISTENING = re.compile(r"WebDriver BiDi listening on (ws://\S+)")
_WAIT_S = 60.0
_PREFERENCES = """
user_pref("media.autoplay.default", 0);
user_pref("datareporting.policy.dataSubmissionEnabled", false);
user_pref("browser.shell.checkDefaultBrowser", false);
user_pref("network.captive-portal-service.enabled", false);
user_pref("network.connectivity-service.enabled", false);
"""


class Firefox:
    """One tab. `problems`: errors of its scripts and console, and addresses elsewhere that it asked for."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._count = 0
        self.problems: list[str] = []
        self.call("session.new", capabilities={})
        self.call("session.subscribe", events=["log.entryAdded", "network.beforeRequestSent"])
        self._tab = self.call("browsingContext.getTree")["contexts"][0]["context"]

    def call(self, method: str, **parameters: Any) -> Any:
        """The result of a command of the protocol. Raises RuntimeError with what Firefox says."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=_WAIT_S))
            if message["type"] == "event":
                self._note(message)
            elif message["id"] == self._count:
                if message["type"] == "error":
                    raise RuntimeError(f"{method}: {message['error']}: {message['message']}")
                return message["result"]

    def _note(self, event: dict[str, Any]) -> None:
        found = event["params"]
        if event["method"] == "log.entryAdded" and found["level"] == "error":
            self.problems.append(str(found["text"]))
        if event["method"] == "network.beforeRequestSent":
            address = found["request"]["url"]
            if not address.startswith(("http://127.0.0.1", "file:", "data:", "blob:", "about:")):
                self.problems.append(address)

    def open(self, url: str) -> None:
        self.call("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def evaluate(self, expression: str) -> Any:
        """The value, by way of JSON, of an expression (awaited if it is a promise)."""
        found = self.call(
            "script.evaluate",
            expression=f"(async () => JSON.stringify(await ({expression})))()",
            target={"context": self._tab},
            awaitPromise=True,
        )
        if found["type"] == "exception":
            raise RuntimeError(found["exceptionDetails"]["text"])
        return json.loads(found["result"]["value"])

    def wait_for(self, condition: str) -> None:
        """Until an expression is true. Raises TimeoutError."""
        until = time.monotonic() + _WAIT_S
        while not self.evaluate(f"Boolean({condition})"):
            if time.monotonic() > until:
                raise TimeoutError(condition)
            time.sleep(0.05)

    def click(self, x: float, y: float) -> None:
        """Press and release the first button at (x, y) of the window."""
        self._act(
            {
                "type": "pointer",
                "id": "mouse",
                "actions": [
                    {"type": "pointerMove", "x": round(x), "y": round(y)},
                    {"type": "pointerDown", "button": 0},
                    {"type": "pointerUp", "button": 0},
                ],
            }
        )

    def click_on(
        self, element: str, inside: str = "[box.clientWidth / 2, box.clientHeight / 2]"
    ) -> None:
        """Click on the element of an id, at a point (x, y) from its corner: an expression in which it is `box`."""
        x, y = self.evaluate(
            f"(() => {{ const box = document.getElementById('{element}'), {{ left, top }} = box.getBoundingClientRect();"
            f" const [x, y] = {inside}; return [x + left, y + top]; }})()"
        )
        self.click(x, y)

    def press(self, key: str) -> None:
        """Press and release a key: a character, or a code point of WebDriver's for others."""
        actions = [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]
        self._act({"type": "key", "id": "keyboard", "actions": actions})

    def _act(self, source: dict[str, Any]) -> None:
        self.call("input.performActions", context=self._tab, actions=[source])


@contextmanager
def firefox(folder: Path) -> Iterator[Firefox]:
    """A headless Firefox with a profile of its own in `folder`."""
    assert FIREFOX is not None
    folder.mkdir()
    (folder / "user.js").write_text(_PREFERENCES)
    command = [
        FIREFOX,
        "--headless",
        "--no-remote",
        "--remote-debugging-port=0",
        "--profile",
        str(folder),
    ]
    errors = folder / "stderr.txt"
    with errors.open("w") as file:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file)
    try:
        until = time.monotonic() + _WAIT_S
        while (found := _LISTENING.search(errors.read_text(errors="replace"))) is None:
            if process.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"{FIREFOX} does not listen: {errors.read_text(errors='replace')}")
            time.sleep(0.1)
        with connect(found[1] + "/session", max_size=None) as socket:
            yield Firefox(socket)
    finally:
        process.terminate()
        try:
            process.wait(_WAIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
