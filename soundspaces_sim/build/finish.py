"""The end of a job: a folder whose shards are all there becomes a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from soundspaces_sim.build.job_file import Job, open_job, remove_job
from soundspaces_sim.build.tile import missing
from soundspaces_sim.build.wait import wait_for
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import file_sha256, remove_stale
from soundspaces_sim.dataset.format.floorplan import NAME as FLOORPLAN
from soundspaces_sim.dataset.format.manifest import (
    NAME,
    FileEntry,
    Manifest,
    read_manifest,
    write_manifest,
)


def is_finished(folder: Path) -> bool:
    """Whether the dataset in `folder` is complete; somebody else may have finished its job."""
    return (folder / NAME).is_file() and read_manifest(folder).complete


def finish_folder(folder: str | Path, timeout_s: float = 0.0) -> Manifest:
    """Finish the job in `folder`, in any process; a dataset that is complete stays as it is.

    Waits `timeout_s` for shards that other machines have made and that are not visible here yet. Raises
    `DatasetError` if there is no job, or a shard is missing.
    """
    folder = Path(folder)
    if not is_finished(folder):
        try:
            return _finish(open_job(folder), timeout_s)
        except DatasetError:
            if not is_finished(folder):
                raise  # else somebody else was quicker, and took the job away
    remove_job(folder)
    return read_manifest(folder)


def _finish(job: Job, timeout_s: float) -> Manifest:
    """Publish the manifest with the size and SHA-256 of every shard, and delete the job file."""
    draft, folder = job.plan.draft, job.folder
    lacking = list(draft.shards)

    def none_lacks() -> bool:
        lacking[:] = [e for e in lacking if missing(job, e, every_byte=False)]
        return not lacking

    if not wait_for(none_lacks, folder, timeout_s):
        raise DatasetError(
            f"{folder}: {len(lacking)} of {len(draft.shards)} shards are missing, {lacking[0].file} first; make "
            "their tiles, then finish again"
        )
    entries = tuple(msgspec.structs.replace(e, **_seal(folder / e.file)) for e in draft.shards)
    files = tuple(FileEntry(file=n, **_seal(folder / n)) for n in (FLOORPLAN,) if (folder / n).exists())
    manifest = msgspec.structs.replace(draft, status="complete", shards=entries, files=files)
    write_manifest(folder, manifest)
    remove_job(folder)
    remove_stale(folder)  # of workers that were killed on the way
    return manifest


def _seal(path: Path) -> dict[str, Any]:
    """What a manifest says of a file."""
    return {"bytes": path.stat().st_size, "sha256": file_sha256(path)}
