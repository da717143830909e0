"""Workers of clusters import nothing from the current folder: a stranger's file may have a module's name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.build.test_isolation import check_isolated

CHILDREN = {
    "Dask": """
from soundspaces_clusters.dask import DaskOptions, _client
if __name__ == "__main__":
    with _client(DaskOptions(workers=1), 1, 1) as (client, _):
        assert client.submit(len, "abc").result() == 3
""",
    "submitit": """
from soundspaces_clusters.slurm import Share, SlurmOptions, Task, _executor, _submit
executor = _executor([Task(Path("absent"), 0)], SlurmOptions(cluster="local", logs="logs"))
(job,) = _submit(executor, [()], 1, None)
assert job.result() == []
""",
}


@pytest.mark.parametrize(("kind", "package"), [("Dask", "distributed"), ("submitit", "submitit")])
def test_a_stranger_s_module_is_not_run(kind: str, package: str, tmp_path: Path) -> None:
    pytest.importorskip(package)
    check_isolated(CHILDREN[kind], tmp_path, Path(__file__).parents[1] / "src")
