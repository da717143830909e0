"""The page docs/settings.md, made from the records of settings: every setting of `make rirs` and its default.

python -m soundspaces_sim.core.settings_page > docs/settings.md
"""

from __future__ import annotations

import inspect
import json
import re
from typing import Any, Literal, get_args, get_origin

import msgspec

from soundspaces_sim.core.config import JobConfig

_HEAD = """\
# Settings

Made from the records of `soundspaces_sim.core.config` by `python -m soundspaces_sim.core.settings_page`. A file of
settings (`CONFIG=`, `--config`) is TOML with a table for each heading below; what it leaves out has the default.
`pipelines/default.toml` shows the most used ones, `pipelines/paper.toml` follows the seed paper,
`pipelines/patio.toml` is for scenes with patios. From Python: `ss.SimulationConfig(walks=1000)` and so on, put
together in `ss.JobConfig`. "Not set" is `None` there; TOML has no such value, so leave the setting out.
"""


def settings_page() -> str:
    """The whole page, Markdown."""
    return "\n".join([_HEAD, *(_table(field) for field in msgspec.structs.fields(JobConfig))])


def _table(stage: Any) -> str:
    notes = _comments(stage.type)
    rows = [
        f"| `{field.name}` | {_value(field.default)} | {_kind(field.type)} | {notes.get(field.name, '')} |"
        for field in msgspec.structs.fields(stage.type)
    ]
    text = inspect.cleandoc(stage.type.__doc__ or "").replace("``", "`")
    text = re.sub(r"(?<!\n)\n(?=`\w+`:)", "\n\n", text)  # a paragraph for each setting
    return "\n".join(
        [
            f"## `[{stage.name}]`",
            "",
            text,
            "",
            "| setting | default | type | note |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


def _comments(record: type) -> dict[str, str]:
    """What stands beside the settings of a record in its source: units and symbols."""
    found = re.findall(r"^    (\w+): [^#\n]*  # (.+)$", inspect.getsource(record), re.MULTILINE)
    return {name: text.replace("|", "\\|") for name, text in found}


def _value(default: Any) -> str:
    """A default as TOML has it."""
    if default is None:
        return "not set"
    return f"`{json.dumps(default)}`"


def _kind(annotation: Any) -> str:
    if get_origin(annotation) is Literal:
        return " or ".join(f'`"{choice}"`' for choice in get_args(annotation))
    alternatives = [a for a in get_args(annotation) if a is not type(None)]
    if get_origin(annotation) is tuple:
        return "list of numbers" if alternatives[0] is float else "list of pairs of numbers"
    names = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    return names[alternatives[0] if alternatives else annotation]


if __name__ == "__main__":
    print(settings_page(), end="")
