"""Records of settings: frozen, checked where they enter, with the names that settings had before.

A stage's record may hold tables of its own (`[simulation.diffraction]`). A table with a setting `enabled` may be
given as true or false: ``diffraction = false``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import msgspec

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.keywords import check_keywords

#: Settings of [simulation] by their former names: (table, name), or (name,) where it has changed its name alone.
FORMER_NAMES: Mapping[str, tuple[str, ...]] = {
    "specular_ratio": ("specular", "ratio"),
    "joined_walks": ("connections", "subpaths"),
    "joins_per_vertex": ("connections", "per_vertex"),
    "join_window": ("connections", "window"),
    "radius_min": ("receiver_volumes", "radius_min"),
    "radius_growth": ("receiver_volumes", "radius_growth"),
    "radius_max": ("receiver_volumes", "radius_max"),
    "merging": ("radiance_transfer", "enabled"),
    "smooth": ("denoise",),
    "sheets": ("porous_layers",),
}


def present_names(simulation: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of [simulation] under their present names. Raises `ConfigError` for one given under both."""
    given: dict[str, Any] = {}
    for name, value in simulation.items():
        if name not in FORMER_NAMES and isinstance(value, bool) and name in _SWITCHES:
            given[name] = {"enabled": value}
        elif name not in FORMER_NAMES:
            given[name] = dict(value) if isinstance(value, Mapping) else value
    for name in FORMER_NAMES.keys() & simulation.keys():
        *tables, own = FORMER_NAMES[name]
        into = given
        for table in tables:
            into = into.setdefault(table, {})
            if not isinstance(into, dict):
                raise ConfigError(f"simulation.{name}: give simulation.{table}.{own} instead")
        if own in into:
            raise ConfigError(
                f"simulation.{name}: simulation.{'.'.join(FORMER_NAMES[name])} is given as well"
            )
        into[own] = simulation[name]
    return given


_SWITCHES = ("radiance_transfer", "diffraction")


class _Checked(msgspec.StructMeta):
    """Settings that are unknown, or of another type, are a `ConfigError`."""

    def __call__(cls, *args: Any, **given: Any) -> Any:  # noqa: N805
        given = cls._present(given)  # type: ignore[attr-defined]
        check_keywords(cls.__name__, given, cls.__struct_fields__)
        fields = {f.name: f.type for f in msgspec.structs.fields(cls)}  # type: ignore[arg-type]
        try:
            tables = {
                name: value if isinstance(value, fields[name]) else msgspec.convert(value, fields[name])
                for name, value in given.items()
                if isinstance(fields[name], type) and issubclass(fields[name], Settings)
            }
            return super().__call__(*args, **{**given, **tables})
        except (TypeError, msgspec.ValidationError) as error:
            for name, value in given.items():
                try:
                    msgspec.convert(value, fields[name])
                except msgspec.ValidationError as problem:
                    text = f"{cls.stage}.{name}: {str(problem)[0].lower()}{str(problem)[1:]} ({value!r:.80})"  # type: ignore[attr-defined]
                    raise ConfigError(text) from error
            raise


class Settings(
    msgspec.Struct, metaclass=_Checked, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """A record whose repr shows what is not as by default; `stage` is its table in a config file."""

    stage: ClassVar[str] = ""

    @classmethod
    def _present(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Settings under their present names."""
        return present_names(given) if cls.stage == "simulation" else given

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
