"""`job.npz`: what a worker needs to make any tile of a job, beside the tile's number.

It lies in the dataset's folder from the start of a job to its finish, and holds the plan, the triangles
with their materials, and the walking distances: arrays, no pickles. It goes when the dataset is complete,
because scenes may not be passed on where their datasets may. Its digest covers every byte of its content,
and the scene and the settings that are read must give the plan's keys.
"""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from soundspaces_sim.build.plan import JobPlan, job_key
from soundspaces_sim.core.errors import DatasetError, SoundSpacesSimError
from soundspaces_sim.core.io.files import delete, publish
from soundspaces_sim.core.io.untrusted import open_regular
from soundspaces_sim.core.numerics.target import code_target
from soundspaces_sim.core.version import __version__
from soundspaces_sim.dataset.format.manifest import Manifest
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.kept_traces import KeptTraces
from soundspaces_sim.transport.low_method import LowRuns, low_method
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import largest_side

NAME = "job.npz"
_TABLE = ("frequency_hz", "absorption", "scattering", "transmission")
_UNREADABLE = LookupError, ValueError, TypeError, AttributeError, OverflowError, RecursionError
_AGAIN = "run the same `make rirs` again"


class _Origin(msgspec.Struct):
    """What any version's plan says of who made it."""

    code_version: str
    target: str = ""


@dataclass(frozen=True)
class Job:
    """A plan, where its shards go, and what its tiles are made from.

    `geodesic` (N, N) float32 m. `prepared`: the scene's model, if it was made already.
    """

    folder: Path
    plan: JobPlan
    scene: Scene
    geodesic: np.ndarray
    prepared: Model | None = None

    @cached_property
    def points(self) -> np.ndarray:
        """(N, 3) m."""
        return np.array(self.plan.draft.points, float).reshape(-1, 3)

    @cached_property
    def model(self) -> Model:
        """The scene in the kernels' form, of the plan's duration."""
        if self.prepared is not None:
            return self.prepared
        config = self.plan.draft.config
        known = msgspec.structs.replace(config.simulation, duration=self.plan.draft.duration)
        return make_model(self.scene, self.points, known, config.dataset.seed)

    @cached_property
    def side(self) -> int:
        """Points on a side of what this process simulates as one, by its memory."""
        return largest_side(self.model, len(self.points))

    @cached_property
    def kept(self) -> KeptTraces:
        """What tiles that this process makes one after the other keep for each other."""
        return KeptTraces(self.model, self.folder)

    @cached_property
    def waves(self) -> LowRuns | None:
        """The runs of its points below an edge, if it has waves."""
        method = low_method(self.model.config)
        return None if method is None else method.make_runs(self.model, self.points, self.folder)

    @property
    def keeps(self) -> bool:
        """Whether there is such."""
        return "kept" in self.__dict__


def write_job(job: Job) -> None:
    """Publish the job file in the job's folder. Raises `DatasetError`."""
    scene, table = job.scene, job.scene.materials
    arrays = {
        "plan": np.frombuffer(msgspec.json.encode(job.plan.draft), np.uint8),
        "block": np.array(job.plan.block),
        "geodesic": job.geodesic,
        "vertices": scene.vertices,
        "faces": scene.faces,
        "face_material": scene.face_material,
        "materials": np.array(table.names),
        **{name: getattr(table, name) for name in _TABLE},
        "reflection": np.array(table.reflection),
        "mounting": np.array(table.mounting),
    }
    content = io.BytesIO()
    np.savez(content, **arrays, digest=np.array(_digest(arrays)))
    publish(job.folder / NAME, content.getvalue())


def remove_job(folder: Path) -> None:
    """Delete the job file of a job that is finished, if it is there."""
    if (folder / NAME).exists():
        delete(folder / NAME)


_held: dict[Path, Job] = {}


@contextmanager
def job_in_memory(job: Job) -> Iterator[None]:
    """Within, `open_job` gives this process the job that it has prepared, whatever becomes of the job file."""
    path = (job.folder / NAME).resolve()
    _held[path] = job
    try:
        yield
    finally:
        del _held[path]


def has_job(folder: Path) -> bool:
    """Whether a job is under way in a folder: its job file is there, or this process holds it."""
    path = (folder / NAME).resolve()
    return path in _held or path.is_file()


def open_job(folder: str | Path) -> Job:
    """The job of a folder, for a worker; read and prepared once per process and digest.

    Raises `DatasetError` if there is none, it is damaged, or another version of the package made it.
    """
    path = (Path(folder) / NAME).resolve()
    if path in _held:
        return _held[path]
    if not os.path.lexists(Path(folder) / NAME):
        raise DatasetError(f"{folder}: no job is under way here ({NAME} is missing); {_AGAIN}")
    with _opened(Path(folder).resolve() / NAME) as file:
        digest = str(file["digest"])
    return _read(Path(folder).resolve() / NAME, digest)


@lru_cache(maxsize=2)
def _read(path: Path, _digest_there: str) -> Job:
    with _opened(path) as file:
        arrays = {name: file[name] for name in file.files}
        digest = str(arrays.pop("digest"))
        whole = digest == _digest(arrays)
    if not whole:
        raise DatasetError(f"{path}: this job is damaged (its digest differs); {_AGAIN}")
    return _checked(path, arrays)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The arrays of a job file, read as they are asked for. Raises `DatasetError`."""
    try:
        with open_regular(path, DatasetError, "job", follow=False) as opened:
            with zipfile.ZipFile(opened) as archive:
                if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                    raise ValueError("compressed arrays")  # which may unpack to any size
            opened.seek(0)
            with np.load(opened, allow_pickle=False) as file:
                yield file
    except DatasetError:
        raise
    except Exception as error:  # the parsers raise whatever they meet in a damaged file
        raise DatasetError(f"{path}: cannot read this job ({error!r}); {_AGAIN}") from error


def _checked(path: Path, arrays: dict[str, np.ndarray]) -> Job:
    """The job of arrays that are what was written. Raises `DatasetError` if this version cannot go on with it."""
    try:
        plan = arrays["plan"].tobytes()
        _check_origin(path, msgspec.json.decode(plan, type=_Origin))
        draft = msgspec.json.decode(plan, type=Manifest)
        table = MaterialTable(
            tuple(arrays["materials"].tolist()),
            *(arrays[name] for name in _TABLE),
            reflection=tuple(arrays["reflection"].tolist()),
            mounting=tuple(arrays["mounting"].tolist()),
        )
        mesh = arrays["vertices"], arrays["faces"], arrays["face_material"]
        scene = Scene(*mesh, table, name=draft.scene, notes=draft.notes)
        job = Job(path.parent, JobPlan(draft, int(arrays["block"])), scene, arrays["geodesic"])
    except DatasetError:
        raise
    except (*_UNREADABLE, msgspec.MsgspecError, SoundSpacesSimError) as error:
        raise DatasetError(f"{path}: not a job of this version ({error}); {_AGAIN}") from error
    key = job_key(scene.digest, draft.config, draft.duration, job.points)
    if (scene.digest, key) != (draft.scene_digest, draft.key):
        raise DatasetError(f"{path}: scene and settings do not give the keys of the plan; {_AGAIN}")
    return job


def _check_origin(path: Path, made: _Origin) -> None:
    """Raise `DatasetError` for a plan of another version, which may be of another form, or for another machine."""
    if made.code_version != __version__:
        raise DatasetError(
            f"{path}: version {made.code_version} of soundspaces_sim planned this job, this is version "
            f"{__version__}; all workers of a job need the same"
        )
    if made.target != code_target():
        raise DatasetError(
            f"{path}: this job was planned on another machine (code for {made.target or 'one not recorded'}, here "
            f"for {code_target()}), whose results have other last digits; all workers of a job need the same kind"
        )


def _digest(arrays: dict[str, np.ndarray]) -> str:
    sha = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        sha.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()
