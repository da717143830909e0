"""Records of settings: frozen, and checked where they enter.

A stage's record may hold tables of its own (`[simulation.diffraction]`).
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal, get_args, get_origin

import msgspec
import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.keywords import check_keywords


class _Checked(msgspec.StructMeta):
    """Settings that are unknown, or of another type, are a `ConfigError`."""

    def __call__(cls, *args: Any, **given: Any) -> Any:  # noqa: N805
        given = cls._given(given)  # type: ignore[attr-defined]
        check_keywords(cls.__name__, given, cls.__struct_fields__)
        fields = {f.name: f.type for f in msgspec.structs.fields(cls)}  # type: ignore[arg-type]
        try:
            _check_choices(cls, given, fields)
            typed = {name: _typed(value, fields[name]) for name, value in given.items()}
            return super().__call__(*args, **typed)
        except (TypeError, msgspec.ValidationError) as error:
            for name, value in given.items():
                try:
                    msgspec.convert(value, fields[name])
                except msgspec.ValidationError as problem:
                    said = without_null(str(problem))
                    text = f"{cls.stage}.{name}: {said[0].lower()}{said[1:]} ({value!r:.80})"  # type: ignore[attr-defined]
                    raise ConfigError(text) from error
            raise


def choices_of(kind: Any) -> tuple[str, ...]:
    """The strings of which a setting is one, or None if it may be; () for other settings."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    return next((get_args(k) for k in get_args(kind) if get_origin(k) is Literal), ())


def without_null(message: str) -> str:
    """msgspec's message without the null that a setting may be, for which a file has no word."""
    return message.replace(" | null`", "`")


def _typed(value: Any, kind: Any) -> Any:
    """A setting as a file would give it: a table as its record, 1 as 1.0 where the setting is a float, for keys and
    files tell them apart. What is neither a table nor a number nor a row of them stays."""
    if isinstance(kind, type) and issubclass(kind, Settings):
        return value if isinstance(value, kind) else msgspec.convert(value, kind)
    whole = kind is int or (int in get_args(kind) and float not in get_args(kind))
    if isinstance(value, tuple | list | int | np.number) or (whole and isinstance(value, float)):
        return msgspec.convert(_plain(value), kind)
    return value


def _plain(value: Any) -> Any:
    """Numbers of NumPy as Python's, also in rows of rows."""
    if isinstance(value, tuple | list):
        return tuple(_plain(v) for v in value)
    return value.item() if isinstance(value, np.generic) else value


def _check_choices(record: Any, given: dict[str, Any], types: dict[str, Any]) -> None:
    """Check settings that are true or false, or one of some strings; what comes from a file msgspec has
    checked."""
    for name, value in given.items():
        kind = types[name]
        choices = (True, False) if kind is bool else choices_of(kind)
        if value is None and type(None) in get_args(kind):
            continue
        if choices and not (isinstance(value, bool | str) and value in choices):
            expected = " or ".join(map(repr, choices))
            raise ConfigError(f"{record.stage}.{name}: expected {expected}, got {value!r:.80}")


class Settings(
    msgspec.Struct, metaclass=_Checked, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """A record whose repr shows what is not as by default; `stage` is its table in a config file."""

    stage: ClassVar[str] = ""

    @classmethod
    def _given(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Settings as fields; a record whose tables may be given as true or false overrides it."""
        return given

    def __repr__(self) -> str:
        default = type(self)()
        own = {name: getattr(self, name) for name in self.__struct_fields__}
        changed = (f"{name}={x!r}" for name, x in own.items() if x != getattr(default, name))
        return f"{type(self).__name__}({', '.join(changed)})"


def flat(settings: Settings) -> dict[str, Any]:
    """Every setting of a record by its name, those of its tables as ``table.name``."""
    out: dict[str, Any] = {}
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, Settings):
            out.update({f"{name}.{own}": x for own, x in flat(value).items()})
        else:
            out[name] = value
    return out
