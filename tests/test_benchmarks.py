"""Benchmarks' stored runs and the page that is written from them."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks import report
from benchmarks.__main__ import main
from benchmarks.speed import baseline
from benchmarks.tools import catalogue, record
from benchmarks.tools.record import Column, Machine, Result, Table, table
from tests.marks import ci_slow

NAMES = catalogue.names()
RESULT = Result(
    name="speed.a",
    question="How long?",
    command="run speed.a",
    commit="1234567",
    date="2026-11-22",
    machine=Machine("a processor", 2, 9.5),
    tables=(Table("A title", (Column("what"), Column("time", "s")), (("read | write", 1.25),)),),
)


@pytest.mark.parametrize("name", NAMES)
def test_a_benchmark_says_what_it_is(name: str) -> None:
    assert set(catalogue.describe(name)) == set(catalogue.PARTS)


def test_a_docstring_without_its_parts_is_refused() -> None:
    text = "Question: How long?\n\nMethod: A clock.\n\nTakes: A minute."
    with pytest.raises(ValueError, match="a: its docstring lacks Amortised"):
        catalogue.parts_of("a", text)


def test_stored_runs_are_of_benchmarks_that_there_are() -> None:
    found = record.stored()
    assert {r.name for r in found} <= set(NAMES) and len(found) > 8


def test_a_table_as_markdown() -> None:
    text = report.section(RESULT)
    assert "| what | time, s |\n| --- | --- |\n| read \\| write | 1.25 |" in text
    assert "2026-11-22, commit 1234567; a processor, 2 cores, load 9.5 at the start." in text


def test_the_page_shows_a_runs_first_table_and_the_middle_band_of_a_long_one() -> None:
    rows = tuple((band, k) for band in ("0 to 176", "775 to 3409") for k in range(9))
    long = Table("By band", (Column("band", "Hz"), Column("run")), rows)
    text = report.section(msgspec.structs.replace(RESULT, tables=(long, *RESULT.tables)))
    assert "775 to 3409 | 8 |" in text and "0 to 176" not in text and "A title" not in text
    assert "9 more rows are in the stored run." in text and "with 1 more table." in text


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, ""), (20164, "20,164"), (0.123456, "0.1235"), (12345.6, "12,346"), (1.2e-7, "1.2e-07"), ("–", "–"), (0.0, "0")],
)  # fmt: skip
def test_numbers_on_the_page(value: record.Cell, text: str) -> None:
    assert report.number(value) == text


def test_rows_that_do_not_fit_and_numbers_that_are_none_are_refused() -> None:
    for bad in (math.nan, math.inf, np.float32("nan")):
        with pytest.raises(ValueError, match="expected finite numbers"):
            table("a", ["x"], [[bad]])
    with pytest.raises(ValueError, match="expected rows of 2 cells"):
        table("a", ["x", ("y", "s")], [[1]])
    assert table("a", ["x"], [[np.float64(1.23456)], [np.int64(3)]]).rows == ((1.235,), (3,))


def test_a_stored_run_comes_back(tmp_path: Path) -> None:
    assert record.load(record.save(RESULT, tmp_path)) == RESULT
    assert record.stored(tmp_path) == [RESULT]
    bad = tmp_path / "bad.json"
    bad.write_text("{}")
    with pytest.raises(ValueError, match=r"bad\.json: expected a stored run"):
        record.load(bad)


def test_a_ratio_and_its_spread() -> None:
    """Logarithms of 2, 8: mean log 4, standard deviation log 2 · √2, so that of the mean is log 2."""
    mean, factor = baseline.ratio([(2.0, 1.0), (8.0, 1.0)])
    assert mean == pytest.approx(4.0, rel=1e-12) and factor == pytest.approx(2.0, rel=1e-12)
    for bad in ([(1.0, 1.0)], [(1.0, 1.0), (math.nan, 1.0)], [(1.0, 1.0), (1.0, 0.0)]):
        with pytest.raises(ValueError, match="at least two pairs above 0"):
            baseline.ratio(bad)


@ci_slow
def test_the_baseline_runs_the_package_of_the_checkout(tmp_path: Path) -> None:
    """A checkout whose import takes a second of the processor says so; a folder without the package is refused."""
    other, rest = tmp_path / "other", shutil.ignore_patterns("__pycache__", "*.sofa", "hrtf_data")
    shutil.copytree(record.ROOT / "soundspaces_sim", other / "soundspaces_sim", ignore=rest)
    for data in ("data_schema", "materials", "pipelines"):
        (other / data).symlink_to(record.ROOT / data)
    slow = "\nimport time\n_END = time.process_time() + 1.0\nwhile time.process_time() < _END: pass\n"
    with (other / "soundspaces_sim" / "__init__.py").open("a") as file:
        file.write(slow)
    (tmp_path / "scenes").mkdir(mode=0o700)
    theirs, memory = baseline.measure("import", other, tmp_path)
    assert theirs["import soundspaces_sim"] >= 1.0 and memory > 10.0
    with pytest.raises(RuntimeError, match="expected the package of"):
        baseline.measure("import", tmp_path / "nowhere", tmp_path)


def test_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "speed.nothing"]) == 2
    assert "expected one of speed.alternatives" in capsys.readouterr().err
    assert main(["nothing"]) == 2
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "here", "speed.baseline"], cwd=record.ROOT, capture_output=True, text=True
    )  # fmt: skip
    assert done.returncode == 3 and "left out: it needs the path of another checkout" in done.stdout
