"""The end of a job: a folder whose shards are all there becomes a dataset."""

from __future__ import annotations

from pathlib import Path

import msgspec

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.base.files import file_sha256
from soundspaces_sim.jobs.record import Job, open_job, remove_job
from soundspaces_sim.jobs.tile import missing
from soundspaces_sim.storage.floorplan import NAME as FLOORPLAN
from soundspaces_sim.storage.manifest import NAME, FileEntry, Manifest, read_manifest, write_manifest


def finish_folder(folder: str | Path) -> Manifest:
    """Finish the job in `folder`, in any process; a dataset that is complete stays as it is.

    Raises `DatasetError` if there is no job, or a shard is missing.
    """
    folder = Path(folder)
    if (folder / NAME).is_file() and (found := read_manifest(folder)).complete:
        remove_job(folder)
        return found
    return finish_job(open_job(folder))


def finish_job(job: Job) -> Manifest:
    """Publish the manifest with the size and SHA-256 of every shard, and delete the job's record.

    Raises `DatasetError` if a shard is missing or of something else.
    """
    draft, folder = job.plan.draft, job.folder
    lacking = [e.file for e in draft.shards if missing(job, e, every_byte=False)]
    if lacking:
        raise DatasetError(
            f"{folder}: {len(lacking)} of {len(draft.shards)} shards are missing, {lacking[0]} first; make "
            "their tiles, then finish again"
        )
    entries = tuple(
        msgspec.structs.replace(
            e, bytes=(folder / e.file).stat().st_size, sha256=file_sha256(folder / e.file)
        )
        for e in draft.shards
    )
    files = tuple(
        FileEntry(file=n, bytes=(folder / n).stat().st_size, sha256=file_sha256(folder / n))
        for n in (FLOORPLAN,)
        if (folder / n).is_file()
    )
    manifest = msgspec.structs.replace(draft, status="complete", shards=entries, files=files)
    write_manifest(folder, manifest)
    remove_job(folder)
    return manifest
