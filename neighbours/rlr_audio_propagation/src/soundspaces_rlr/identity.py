"""Under which name and version this engine answers for `rlr_audio_propagation`, also to `importlib.metadata`."""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
from collections.abc import Iterable
from email.message import Message
from importlib.machinery import ModuleSpec
from typing import Any

NAME = "rlr_audio_propagation"
VERSION = "0.0.1+soundspaces"  # of neighbours/rlr_audio_propagation too


def genuine_version() -> str | None:
    """Version of another distribution of the name that is installed, or None."""
    for found in importlib.metadata.distributions(name=NAME):
        if not found.version.endswith("+soundspaces"):
            return found.version
    return None


def announce() -> None:
    """From here on `importlib.metadata` finds this engine under the name, before any other."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


class _Answer(importlib.metadata.Distribution):
    """What a wheel's metadata would say."""

    def read_text(self, filename: str) -> str | None:
        if filename != "METADATA":
            return None
        message = Message()
        message["Metadata-Version"] = "2.1"
        message["Name"] = NAME
        message["Version"] = VERSION
        message["Summary"] = "soundspaces_sim under the name of rlr_audio_propagation"
        return message.as_string()

    def locate_file(self, path: str | os.PathLike[str]) -> Any:
        raise NotImplementedError(f"{NAME} {VERSION} has no files of its own: {path}")


class _Finder(importlib.metadata.DistributionFinder):
    """Finds `_Answer`, and no module."""

    def find_spec(self, *_: Any) -> ModuleSpec | None:
        return None

    def find_distributions(
        self, context: importlib.metadata.DistributionFinder.Context | None = None
    ) -> Iterable[importlib.metadata.Distribution]:
        name = None if context is None else context.name
        wanted = name is None or re.sub(r"[-_.]+", "_", name).lower() == NAME
        return [_Answer()] if wanted else []
