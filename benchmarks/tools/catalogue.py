"""Which benchmarks there are, and what their docstrings say of them."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
from pathlib import Path
from types import ModuleType

PACKAGES = ("speed", "accuracy", "experiments")
PARTS = ("Question", "Method", "Amortised", "Takes")
_ROOT = Path(__file__).resolve().parents[1]


def names() -> list[str]:
    """Names of all benchmarks, ``package.module``, in the order in which the page has them."""
    return [
        f"{package}.{found.name}"
        for package in PACKAGES
        for found in pkgutil.iter_modules([str(_ROOT / package)])
    ]


def module_of(name: str) -> ModuleType:
    """Import a benchmark."""
    return importlib.import_module(f"benchmarks.{name}")


def describe(name: str) -> dict[str, str]:
    """What a benchmark's docstring says, a paragraph ``Part: …`` for each of `PARTS`; nothing is imported for it.

    Raises `ValueError` where a part is missing.
    """
    source = (_ROOT / f"{name.replace('.', '/')}.py").read_text("utf-8")
    return parts_of(name, ast.get_docstring(ast.parse(source)) or "")


def parts_of(name: str, text: str) -> dict[str, str]:
    """The parts of a docstring. Raises `ValueError` where one is missing."""
    paragraphs = [" ".join(p.split()) for p in re.split(r"\n\s*\n", text)]
    found = {
        part: p.removeprefix(f"{part}:").strip()
        for part in PARTS
        for p in paragraphs
        if p.startswith(f"{part}:")
    }
    missing = [part for part in PARTS if not found.get(part)]
    if missing:
        raise ValueError(f"{name}: its docstring lacks {', '.join(missing)}")
    return found
