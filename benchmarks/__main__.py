"""`python -m benchmarks list | run NAME … [-- ARGUMENTS] | report`; `run all` runs every benchmark, as `make
bench`.

Each benchmark runs in a process of its own, which stores what it measured in benchmarks/results. One that lacks
something (data of ../shared, another program) is left out with a line that says what, and its stored run stays.
Exit code 1 if one failed, or one asked for by name was left out.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from benchmarks import report
from benchmarks.tools.catalogue import describe, module_of, names
from benchmarks.tools.record import UnavailableError, Watch, save

_LEFT_OUT = 3  # exit code of a child whose benchmark is unavailable


def run_here(name: str, arguments: Sequence[str]) -> int:
    """Run and store one benchmark in this process."""
    watch = Watch()
    module = module_of(name)
    try:
        tables = module.run(*arguments)
    except UnavailableError as why:
        print(f"{name}: left out: {why}", flush=True)
        return _LEFT_OUT
    text = describe(name)
    result = watch.result(name, text["Question"], arguments, tables)
    print(report.section(result), flush=True)
    print(f"Stored in {save(result)}", flush=True)
    return 0


def run(chosen: Sequence[str], arguments: Sequence[str]) -> int:
    """Run benchmarks one after the other; ``["all"]`` is all of them."""
    everything = list(chosen) == ["all"]
    wanted = names() if everything else list(chosen)
    unknown = sorted(set(wanted) - set(names()))
    if unknown or not wanted or (arguments and len(wanted) > 1):
        print(
            f"expected one of {', '.join(names())} (arguments after -- for one alone), got {wanted}",
            file=sys.stderr,
        )
        return 2
    codes = {}
    for name in wanted:
        command = [sys.executable, "-m", "benchmarks", "here", name, *arguments]
        codes[name] = subprocess.run(command).returncode
    fatal = [n for n, code in codes.items() if code not in (0, *([_LEFT_OUT] if everything else []))]
    if fatal:
        print(f"failed: {', '.join(fatal)}", file=sys.stderr)
    report.main()
    return int(bool(fatal))


def main(arguments: Sequence[str]) -> int:
    """The command line."""
    what, *rest = arguments or [""]
    if what == "here" and rest:
        return run_here(rest[0], rest[1:])
    if what == "run":
        own = rest.index("--") if "--" in rest else len(rest)
        return run(rest[:own], rest[own + 1 :])
    if what == "list":
        for name in names():
            text = describe(name)
            print(f"{name}: {text['Question']} {text['Takes']}")
        return 0
    if what == "report":
        report.main()
        return 0
    print(__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
