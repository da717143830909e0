"""`make validate` writes what it can, where it belongs, and nothing else (what it computes is tested
elsewhere)."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import validate

PAGE = "# Page\n\nText.\n\n<!-- a -->\nold a\n<!-- end of a -->\n\nMore.\n\n<!-- b -->\nold b\n<!-- end of b -->\n"


def _fail(walks: int) -> str:
    raise RuntimeError(f"broken off at {walks} subpaths")


def test_parts_are_written_as_they_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE, "utf-8")
    monkeypatch.setattr(validate, "PAGE", page)
    there, absent = (lambda: True), (lambda: False)
    parts = {"a": (lambda walks: f"new at {walks}", there, ""), "b": (_fail, there, "")}
    monkeypatch.setattr(validate, "PARTS", parts)
    with pytest.raises(RuntimeError, match="broken off at 7 subpaths"):
        validate.main(7)
    assert page.read_text("utf-8") == PAGE.replace("old a", "new at 7")
    monkeypatch.setattr(validate, "PARTS", {**parts, "b": (_fail, absent, "no data")})
    validate.main(8)
    assert page.read_text("utf-8") == PAGE.replace("old a", "new at 8")
    assert "b: no data; its tables stay as they are" in capsys.readouterr().out
    validate.main(9, "b")
    assert page.read_text("utf-8") == PAGE.replace("old a", "new at 8")


def test_a_page_without_marks_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE.replace("<!-- end of a -->", ""), "utf-8")
    monkeypatch.setattr(validate, "PAGE", page)
    monkeypatch.setattr(validate, "PARTS", {"a": (lambda _: "new", lambda: True, "")})
    with pytest.raises(SystemExit, match="expected one pair of marks"):
        validate.main()
