"""The page docs/settings.md, made from the records of settings: every setting of `make rirs` and its default.

python -m docs.settings_page > docs/settings.md
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

_HEAD = """\
# Settings

Made from the records of `soundspaces_sim.core.config` by `python -m docs.settings_page`. A file of
settings (`CONFIG=`, `--config`) is TOML with a table for each heading below; what it leaves out has the default.
`pipelines/default.toml` shows the most used ones, `pipelines/paper.toml` follows the seed paper,
`pipelines/patio.toml` is for scenes with patios. From Python: `ss.SimulationConfig(walks=1000)` and so on, put
together in `ss.JobConfig`. "Not set" is `None` there; TOML has no such value, so leave the setting out.
"""


#: What is chosen most often: the choice, its default, and what it costs or saves.
_PRICES = (
    (
        "`--spacing` (`grid.spacing`)",
        "1 m of the demo, else 0.5 m",
        "pairs, and so bytes, as the fourth power of its inverse",
    ),
    (
        "`--walks` (`simulation.walks`)",
        "3000 in datasets",
        "time of subpaths in proportion; errors as the inverse root",
    ),
    (
        "`simulation.target_error`",
        "0.05 in single simulations, not set in datasets",
        "as many subpaths as a pair needs, up to `max_walks`: four times for half the error",
    ),
    (
        "`--materials-on-reading` (`simulation.materials`)",
        "off",
        "2.3 to 3.5 times the time, 2.6 times the bytes",
    ),
    (
        '`simulation.low.method = "waves"`',
        "rays",
        "a run on a lattice per point, in time as the fourth power of the edge",
    ),
    (
        "`--bands octaves` (`simulation.bands`)",
        "four bands",
        "twice the time, 2.5 times the bytes (demo, nine bands, `plan`)",
    ),
    (
        "`simulation.radiance_transfer = false`",
        "on",
        "saves a sixth (demo, `plan`); late sound is noisier",
    ),
    (
        "`simulation.diffraction = false`",
        "on",
        "saves 7 % of the time, 9 % of the bytes (demo, `plan`); fewer ways around corners",
    ),
    (
        "`--store waveform` or `both` (`dataset.store`)",
        "echogram",
        "some hundred times the bytes (0.6 s at 44.1 kHz, 9 channels)",
    ),
)


def settings_page() -> str:
    """The whole page, Markdown."""
    return "\n".join([_HEAD, _prices(), *_tables(JobConfig)])


def _prices() -> str:
    rows = [f"| {choice} | {default} | {price} |" for choice, default, price in _PRICES]
    return "\n".join(
        ["## What options cost", "", "| option | default | price |", "|---|---|---|", *rows, ""]
    )


def _tables(record: Any) -> Iterator[str]:
    """A table for every record within this one, each followed by those within it."""
    for field in msgspec.structs.fields(record):
        if _is_record(field.type):
            yield _table(field.type)
            yield from _tables(field.type)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Settings)


def _table(record: type[Settings]) -> str:
    notes = _comments(record)
    rows = [
        f"| `{field.name}` | {_value(field.default)} | {_kind(field.type)} | {notes.get(field.name, '')} |"
        for field in msgspec.structs.fields(record)
        if not _is_record(field.type)
    ]
    text = inspect.cleandoc(record.__doc__ or "").replace("``", "`")
    text = re.sub(r"(?<!\n)\n(?=`\w+`:)", "\n\n", text)  # a paragraph for each setting
    head = ["| setting | default | type | note |", "|---|---|---|---|"]
    return "\n".join([f"## `[{record.stage}]`", "", text, "", *head, *rows, ""])


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
    if choices_of(annotation):
        return " or ".join(f'`"{choice}"`' for choice in choices_of(annotation))
    alternatives = [a for a in get_args(annotation) if a is not type(None)]
    if get_origin(annotation) is tuple:
        return "list of numbers" if alternatives[0] is float else "list of pairs of numbers"
    names = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    return names[alternatives[0] if alternatives else annotation]


if __name__ == "__main__":
    print(settings_page(), end="")
