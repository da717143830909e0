"""One shard: echograms of some sources × some listeners in one HDF5 file, whole or absent.

A shard is written under a unique temporary name, flushed to disk, checked, and published by rename, so
a file under its final name is complete. It holds no clock times: the same content is the same bytes.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from soundspaces_sim import schema
from soundspaces_sim.echogram import Arrivals, Echogram, Echograms, direct_arrival
from soundspaces_sim.errors import DatasetError

STEP_DB = 0.4
_LOWEST = 1  # code of the least energy that is kept: 254 steps below the peak
OK, SILENT, FAILED = 0, 1, 2


def encode(echoes: Echograms, source_index: np.ndarray, listener_index: np.ndarray) -> dict[str, Any]:
    """The shard's datasets, by name. Energies to `STEP_DB`, moment ratios to 1/127."""
    energy = echoes.energy[:, :, :, 0]
    peak = energy.max(axis=(2, 3))
    safe = np.where(peak > 0.0, peak, 1.0)[:, :, None, None]
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(energy / safe)
    code = np.where(energy > 0.0, np.rint(255.0 + level / STEP_DB), 0.0)
    code = np.where(code >= _LOWEST, code, 0.0).astype(np.uint8)
    ratio = np.divide(
        echoes.energy[:, :, :, 1:], energy[:, :, :, None], out=np.zeros_like(echoes.energy[:, :, :, 1:]),
        where=(code > 0)[:, :, :, None],
    )  # fmt: skip
    moments = np.rint(np.clip(ratio, -1.0, 1.0) * 127.0).astype(np.int8).transpose(0, 1, 2, 4, 3)
    counts = np.diff(echoes.early_start).reshape(echoes.shape)
    silent = (peak <= 0.0) & (echoes.direct_energy.max(axis=2) <= 0.0) & (counts == 0)
    failed = ~np.isfinite(echoes.energy).all(axis=(2, 3, 4))
    status = np.where(failed, FAILED, np.where(silent, SILENT, OK))
    return {
        "source_index": source_index.astype(np.int64),
        "listener_index": listener_index.astype(np.int64),
        "source_position": echoes.sources,
        "listener_position": echoes.listeners,
        "band_edges": np.array(echoes.bands),
        "time_edges": echoes.time_edges,
        "energy_peak": peak.astype(np.float32),
        "energy": code,
        "moments": moments,
        "direct_energy": echoes.direct_energy.astype(np.float32),
        "walls": np.minimum(echoes.walls, 65535).astype(np.uint16),
        "early_start": echoes.early_start.astype(np.int64),
        "early_delay": echoes.early.delay,
        "early_energy": echoes.early.energy.astype(np.float32),
        "early_direction": echoes.early.direction.astype(np.float32),
        "early_planes": echoes.early.planes.astype(np.int16),
        "relative_error": np.minimum(echoes.relative_error, 6e4).astype(np.float16),
        "status": status.astype(np.uint8),
    }


def publish(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary file beside `path`, then make it `path`, durably and at once."""
    temporary = path.with_name(
        f".{path.name}.{socket.gethostname()}.{os.getpid()}.{secrets.token_hex(4)}.partial"
    )
    try:
        write(temporary)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def remove_stale(folder: Path) -> None:
    """Delete temporary files that processes of this machine left behind when they were killed."""
    for path in folder.glob(f".*.{socket.gethostname()}.*.partial"):
        process = path.name.split(".")[-3]
        if process.isdigit() and not _alive(int(process)):
            path.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def write_shard(path: Path, data: dict[str, Any], attributes: dict[str, Any]) -> None:
    """Publish a shard; `data` from `encode`, `attributes` beyond the fixed conventions."""

    def write(temporary: Path) -> None:
        with h5py.File(temporary, "w-") as file:
            for name, value in data.items():
                chunks = True if value.ndim == 0 or value.size == 0 else _chunks(name, value.shape)
                file.create_dataset(
                    name, data=value, chunks=chunks, maxshape=value.shape,
                    shuffle=True, compression="gzip", compression_opts=4, fletcher32=True,
                )  # fmt: skip
            for name, value in {
                "format": schema.FORMAT,
                "schema_version": schema.VERSION,
                "energy_step_db": STEP_DB,
                **schema.fixed_attributes(),
                **attributes,
            }.items():
                file.attrs[name] = value
        with h5py.File(temporary, "r") as file:
            schema.check(file, str(path))

    try:
        publish(path, write)
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot write this shard ({error}); finished shards are safe, free some space or "
            "choose another OUT and run again"
        ) from error


def _chunks(name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    if name in ("energy", "moments"):  # one pair per chunk: what a reader asks for
        return (1, 1, *shape[2:])
    return tuple(max(1, n) for n in shape)


def is_valid(path: Path, key: str) -> bool:
    """True if `path` is a complete shard with this key, all of whose bytes can be read."""
    if not path.is_file():
        return False
    try:
        with h5py.File(path, "r") as file:
            schema.check(file, str(path))
            if file.attrs["key"] != key:
                return False
            for name in schema.schema()["datasets"]:
                file[name][...]  # reads every chunk, so that fletcher32 sees it
    except (OSError, DatasetError):
        return False
    return True


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, as hex."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class ShardReader:
    """An open shard. Raises `DatasetError` if it is missing or not what the schema says."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = h5py.File(path, "r", rdcc_nbytes=0)
        except OSError as error:
            raise DatasetError(
                f"{path}: cannot open this shard ({error}); run the same `make rirs` again to rebuild it"
            ) from error
        self._path = path
        try:
            schema.check(self._file, str(path))
        except DatasetError:
            self._file.close()
            raise
        self.bands = tuple(float(e) for e in self._read("band_edges"))
        self.time_edges = self._read("time_edges")
        self.sources = self._read("source_position")
        self.listeners = self._read("listener_position")
        self._c = float(self._file.attrs["speed_of_sound"])
        self._step_db = float(self._file.attrs["energy_step_db"])
        self._table = {
            name: self._read(name)
            for name in (
                "energy_peak", "direct_energy", "walls", "early_start", "early_delay", "early_energy",
                "early_direction", "early_planes", "relative_error", "status",
            )
        }  # fmt: skip

    def _read(self, name: str, where: Any = ...) -> np.ndarray:
        try:
            return np.asarray(self._file[name][where])
        except OSError as error:
            raise DatasetError(
                f"{self._path}: dataset '{name}' is damaged ({error}); delete the file and run the same "
                "`make rirs` again to rebuild it"
            ) from error

    def echogram(self, s: int, l: int) -> Echogram:  # noqa: E741 - source, listener
        """The echogram of local source `s` and listener `l`."""
        t = self._table
        if t["status"][s, l] == FAILED:
            raise DatasetError(f"{self._path}: the simulation of pair ({s}, {l}) failed")
        code = self._read("energy", (s, l)).astype(float)
        ratio = self._read("moments", (s, l)).astype(float) / 127.0
        energy = np.where(
            code > 0.0,
            t["energy_peak"][s, l] * 10.0 ** ((code - 255.0) * self._step_db / 10.0),
            0.0,
        )
        table = np.concatenate(
            [energy[:, None], (ratio * energy[:, :, None]).transpose(0, 2, 1)], axis=1
        )
        offset = self.sources[s] - self.listeners[l]
        direct = direct_arrival(
            offset, float(np.linalg.norm(offset)), t["direct_energy"][s, l].astype(float), self._c
        )
        pair = s * len(self.listeners) + l
        rows = slice(int(t["early_start"][pair]), int(t["early_start"][pair + 1]))
        early = Arrivals(
            t["early_delay"][rows], t["early_energy"][rows].astype(float),
            t["early_direction"][rows].astype(float), t["early_planes"][rows].astype(np.int64),
        )  # fmt: skip
        return Echogram(
            self.bands, self.time_edges, table, direct, early,
            t["relative_error"][s, l].astype(np.float32), bool(t["walls"][s, l] == 0),
        )  # fmt: skip

    def close(self) -> None:
        self._file.close()
