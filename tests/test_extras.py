"""`make test-extras`: which PyTorch is taken, what is skipped and why, and that no group passes by skipping."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest

from pipelines import torch_cpu
from tests import extras

LISTING = "torch (2.15.0)\nAvailable versions: 2.15.0, 2.14.1, 2.13.0+cpu, 2.12.0+cpu\n"


def test_the_newest_cpu_build_is_taken() -> None:
    assert torch_cpu.cpu_version(LISTING, "linux") == "2.13.0+cpu"
    assert torch_cpu.cpu_version(LISTING, "darwin") == "2.15.0"


@pytest.mark.parametrize(
    ("listing", "others"),
    [("", 0), ("Available versions: 2.15.0, 2.14.1", 2)],
    ids=["none", "CUDA alone"],
)
def test_without_one_an_error_says_so(listing: str, others: int) -> None:
    with pytest.raises(LookupError, match=rf"no CPU build of PyTorch .* \({others} other"):
        torch_cpu.cpu_version(listing, "linux")


def test_a_group_whose_program_is_absent_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CHROMIUM", raising=False)
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(extras.SkippedError, match="no Chromium on the path"):
        extras.install(Path(sys.executable), extras.GROUPS["browser"], torch_cpu.INDEX)


def test_a_skip_for_want_of_a_package_fails_the_group(tmp_path: Path) -> None:
    results = tmp_path / "results.xml"
    case = '<testcase name="{}"><skipped message="{}"/></testcase>'
    results.write_text(
        "<testsuites><testsuite>"
        + case.format("test_a", "the extra `train` is not installed")
        + case.format("test_b", "could not import 'ray': No module named 'ray'")
        + case.format("test_c", "there is no Firefox on the path")
        + '<testcase name="test_d"/></testsuite></testsuites>'
    )
    assert [line.partition(":")[0] for line in extras.absent(results)] == ["test_a", "test_b"]


def test_groups_name_extras_and_tests_that_there_are() -> None:
    known = tomllib.loads((extras.ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for group in extras.GROUPS.values():
        assert group.packages or group.extras in known["optional-dependencies"]
        for path in group.tests:
            file, _, name = path.partition("::")
            assert name in (extras.ROOT / file).read_text("utf-8")
