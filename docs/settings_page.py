"""The tables of docs/settings.md: every setting of `make rirs` and its default, from the records of settings.

The site has them (`site_hooks.py`); `python -m docs.settings_page` prints them.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

import msgspec

from soundspaces_sim.core.config import JobConfig
from soundspaces_sim.core.settings import Settings, choices_of


def settings_tables() -> str:
    """Markdown: a heading and a table for each record of settings."""
    return "\n".join(_tables(JobConfig))


def _tables(record: Any) -> Iterator[str]:
    """A table for every record within this one, each followed by those within it."""
    for field in msgspec.structs.fields(record):
        if _is_record(field.type):
            yield _table(field.type)
            yield from _tables(field.type)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Settings)


def _table(record: type[Settings]) -> str:
    intro, meanings = _meanings(record)
    rows = [
        f"| `{field.name}` | {_value(field.default)} | {_kind(field.type)} | {meanings[field.name]} |"
        for field in msgspec.structs.fields(record)
        if not _is_record(field.type)
    ]
    head = ["| setting | default | type | meaning |", "|---|---|---|---|"]
    return "\n".join([f"## `[{record.stage}]`", "", intro, "", *head, *rows, ""])


def _meanings(record: type[Settings]) -> tuple[str, dict[str, str]]:
    """What a record's docstring says of all of it, and of each setting: "`name`: meaning.\""""
    text = " ".join(inspect.cleandoc(record.__doc__ or "").replace("``", "`").split())
    intro, *parts = re.split(r"(?:^|(?<=\. )|(?<=\.\) ))`(\w+)`: ", text)
    return intro.strip(), {
        name: said.strip().rstrip(".").replace("|", "\\|")
        for name, said in zip(parts[::2], parts[1::2], strict=True)
    }


def _value(default: Any) -> str:
    """A default as TOML has it."""
    if default is None:
        return "not set"
    return f"`{json.dumps(default)}`"


def _kind(annotation: Any) -> str:
    if choices_of(annotation):
        return " or ".join(f'`"{choice}"`' for choice in choices_of(annotation))
    alternatives = [a for a in get_args(annotation) if a is not type(None)]
    if get_origin(annotation) is tuple:
        return "list of numbers" if alternatives[0] is float else "list of pairs of numbers"
    names = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    return names[alternatives[0] if alternatives else annotation]


if __name__ == "__main__":
    print(settings_tables(), end="")
