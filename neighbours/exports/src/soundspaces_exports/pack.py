"""One archive of a dataset, for a repository such as Zenodo: the same bytes on every machine.

A plain ZIP without compression (shards are compressed), files in order, their times fixed; beside it its SHA-256 in
the form that `sha256sum -c` reads. Unpacked, it is the dataset.
"""

from __future__ import annotations

import secrets
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

from soundspaces_sim import DatasetError, verify_dataset
from soundspaces_sim.parts import (
    CARDS,
    MANIFEST_NAME as NAME,
    check_target,
    file_sha256,
    publish_file as publish,
)

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time that a ZIP can name
_UNIX, _PLAIN_FILE = 3, 0o100644 << 16
_BLOCK = 1 << 20


def pack_dataset(
    folder: str | Path,
    out: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    replace: bool = False,
) -> Path:
    """Pack a whole dataset into `out`, by default <folder>.zip, and write <out>.sha256; the archive's path.

    Every byte is compared with the manifest first. Files that are there are replaced only if `replace` says so,
    and only regular ones; nothing is written into the dataset's folder. Raises `DatasetError`.
    """
    folder = Path(folder)
    path = archive_path(folder, out)
    if (taken := existing(path)) and not replace:
        raise DatasetError(
            f"{taken[0]}: there is such a file already; delete it, choose another place, or say that it may be "
            "replaced (--replace)"
        )
    manifest, problems = verify_dataset(folder, full=True)
    if problems:
        raise DatasetError(
            f"{folder}: {len(problems)} files are not as the manifest says, {problems[0].file} first "
            f"({problems[0].what}); mend it before packing: `soundspaces-sim verify --full` shows all"
        )
    cards = [name for name in CARDS if (folder / name).is_file() and not (folder / name).is_symlink()]
    names = [NAME, *cards, *sorted(e.file for e in manifest.entries)]
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")
    try:
        with (
            partial.open("xb") as file,
            zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, allowZip64=True) as archive,
        ):
            for k, name in enumerate(names):
                info = zipfile.ZipInfo(f"{folder.absolute().name}/{name}", _EPOCH)
                info.create_system, info.external_attr = _UNIX, _PLAIN_FILE
                info.file_size = (folder / name).stat().st_size
                with (folder / name).open("rb") as source, archive.open(info, "w") as target:
                    shutil.copyfileobj(source, target, _BLOCK)
                if progress is not None:
                    progress(k + 1, len(names))
        partial.replace(path)
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot write this archive ({error}); free some space or choose another place"
        ) from error
    finally:
        partial.unlink(missing_ok=True)
    publish(_digest_path(path), f"{file_sha256(path)}  {path.name}\n".encode())
    return path


def archive_path(folder: Path, out: str | Path | None = None) -> Path:
    """Where a dataset's archive is to lie. Raises `DatasetError` if that is no place for one."""
    path = Path(out) if out is not None else folder.absolute().parent / f"{folder.absolute().name}.zip"
    if (
        folder.resolve() in path.absolute().parent.resolve().parents
        or path.parent.resolve() == folder.resolve()
    ):
        raise DatasetError(f"{path}: lies in the dataset's own folder; choose another place")
    for each in (path, _digest_path(path)):
        check_target(each)
        if each.is_symlink():
            raise DatasetError(f"{each}: a symbolic link; choose another place")
    return path


def existing(path: Path) -> list[Path]:
    """The files that an archive at `path` would replace."""
    return [each for each in (path, _digest_path(path)) if each.exists()]


def _digest_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.sha256")
