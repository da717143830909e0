"""Answers of the explorer's server: JSON and floats, and what a query may say."""

from __future__ import annotations

import json
import math
from http import HTTPStatus
from typing import Any

from soundspaces_explorer import payloads

Answered = tuple[str, bytes]  # content type and body


class RefusedError(Exception):
    """A request that gets no answer, and its status."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


def json_answer(content: Any) -> Answered:
    """As JSON, which has no NaN."""
    return "application/json", json.dumps(content, allow_nan=False, separators=(",", ":")).encode()


def number_in(query: dict[str, str], name: str, most: float, unit: str) -> float:
    """A number of at most `most` either side of 0, which it is where it is not given."""
    try:
        value = float(query.get(name, "0"))
    except ValueError:
        value = math.nan
    if not -most <= value <= most:
        raise RefusedError(HTTPStatus.BAD_REQUEST, f"{name}: expected {unit}")
    return value


def sound_answer(rate: int, query: dict[str, str]) -> Answered:
    """A bundled sound by its name."""
    if query.get("name") not in payloads.SOUNDS:
        raise RefusedError(HTTPStatus.BAD_REQUEST, f"name: expected one of {', '.join(payloads.SOUNDS)}")
    return floats_answer(payloads.sound(query["name"], rate))


def floats_answer(values: Any) -> Answered:
    """As float32, little-endian."""
    return "application/octet-stream", values.astype("<f4").tobytes()
