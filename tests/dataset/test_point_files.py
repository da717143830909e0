"""Files of points: what separates numbers, headers, comments, indices, and lines that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.dataset.exporters.points import points_text, read_points

POINTS = np.array([[1.0, 2.0, 1.5], [-0.5, 3.25, 1.5], [4e-1, 5.0, 1.2]])
_PLAIN = [f"{x} {y} {z}" for x, y, z in POINTS]


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(_PLAIN),
        "\n".join(line.replace(" ", ",") for line in _PLAIN),
        "\r\n".join(line.replace(" ", ", ") for line in _PLAIN) + "\r\n",
        "\n".join(line.replace(" ", "\t") for line in _PLAIN),
        "\n".join(line.replace(" ", ";") for line in _PLAIN),
        "x y z\n" + "\n".join(_PLAIN),
        "\ufeffx,y,z\n" + "\n".join(line.replace(" ", ",") for line in _PLAIN),
        "# measured on Monday\n\nX [m]\tY [m]\tZ [m]\n"
        + "\n".join(f"  {line}  # mark" for line in _PLAIN),
        "idx,x,y,z\n" + "\n".join(f"{i} {_PLAIN[i]}" for i in (2, 0, 1)),
        points_text(POINTS),
    ],
)
def test_points_however_they_are_written(tmp_path: Path, text: str) -> None:
    (tmp_path / "points.txt").write_bytes(text.encode())
    np.testing.assert_allclose(read_points(tmp_path / "points.txt"), POINTS, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n1 2\n", r"line 2: expected 3 finite numbers, as before, got '1 2'"),
        ("x y z\n1 2 3\n4 5 six\n", r"line 3: .*'4 5 six'"),
        ("1 2 3\n\n# so\nnan 1 2\n", "line 4"),
        ("1 2 3\n0 1 2 3\n", "line 2"),
        ("1,,2,3\n", "line 1"),
        ("1 2 x\n1 2 3\n", "line 1"),
        ("a b c\nd e f\n", "line 2"),
        ("1 2 3 4 5\n", "line 1: expected `x y z` or `idx x y z`"),
        ("1 2 3 4\n1 2 3 4\n", "expected indices 0 to 1, each once"),
        ("# nothing\n", "at least one point"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "points.txt").write_text(text)
    with pytest.raises(ss.PointError, match=rf"points\.txt.*{message}"):
        read_points(tmp_path / "points.txt")
