"""`make check`: the quick tests of what has changed since the branch left main.

    python -m tests.changed [BASE]

What has changed are files that git names, committed or not. Of a module those test files are run that import it; of a
test file itself; of a page the tests of pages. With nothing changed nothing is run.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_PAGES = ("tests/test_readme.py", "tests/test_architecture.py")
_ALWAYS = ("tests/test_face.py", "tests/test_parts.py")


def changed(base: str) -> list[str]:
    """Files that differ from where this branch left `base`, and new ones that git does not ignore."""

    def git(*words: str) -> list[str]:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.splitlines()

    (since,) = git("merge-base", "HEAD", base)
    return sorted(
        {*git("diff", "--name-only", since), *git("ls-files", "--others", "--exclude-standard")}
    )


@cache
def imported(file: Path) -> set[str]:
    """Dotted names of modules, and of names within them, that a file imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def module_of(path: str) -> str:
    """The dotted name of a file of Python: of `src/` layouts that below src."""
    parts = Path(path).with_suffix("").parts
    parts = parts[parts.index("src") + 1 :] if "src" in parts else parts
    return ".".join(parts).removesuffix(".__init__")


@cache
def _tests() -> list[Path]:
    return sorted([*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("neighbours/**/test_*.py")])


def files_for(paths: list[str]) -> list[str]:
    """Test files for changed files."""
    modules = {module_of(p) for p in paths if p.endswith(".py")}
    found = {str(t.relative_to(ROOT)) for t in _tests() if modules & imported(t)}
    found |= {p for p in paths if Path(p).name.startswith("test_") and (ROOT / p).is_file()}
    if any(p.endswith(".md") for p in paths):
        found |= set(_PAGES)
    return sorted({*found, *_ALWAYS}) if paths else []


def main() -> int:
    """Run them; pytest's exit code."""
    base = sys.argv[1] if len(sys.argv) > 1 else "main"
    chosen = files_for(changed(base))
    print(f"{len(chosen)} files of tests: {' '.join(chosen)}", flush=True)
    return (
        subprocess.run([sys.executable, "-m", "pytest", "-q", *chosen], cwd=ROOT).returncode
        if chosen
        else 0
    )


if __name__ == "__main__":
    sys.exit(main())
