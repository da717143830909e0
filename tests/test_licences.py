"""An MIT package requires nothing whose licence asks for more than a notice, or for one's own changes to it alone."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

#: SPDX identifiers, and what older metadata say instead.
_ALLOWED = re.compile(
    r"(MIT|MIT-0|BSD|0BSD|BSD-[234]-Clause|(New|3-Clause|2-Clause|Simplified) BSD|Apache-2\.0|Apache 2\.0|"
    r"Apache Software|Apache|ISC|PSF|PSF-2\.0|Python Software Foundation|Zlib|Unlicense|CC0-1\.0|MPL-2\.0|"
    r"Apache-2\.0 WITH LLVM-exception|BSL-1\.0)( License)?( \(ISCL\))?",
    re.IGNORECASE,
)
_BSD = "Redistribution and use in source and binary forms, with or without modification, are permitted"


def _required() -> set[str]:
    """What pyproject.toml requires here, and what that needs."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    found: set[str] = set()
    waiting = [(text, frozenset[str]()) for text in project["dependencies"]]
    while waiting:
        text, wanted = waiting.pop()
        need = Requirement(text)
        applies = need.marker is None or any(need.marker.evaluate({"extra": e}) for e in ("", *wanted))
        if applies and need.name not in found:
            found.add(need.name)
            extras = frozenset(need.extras)
            waiting += [(child, extras) for child in distribution(need.name).requires or ()]
    return found


def licences(name: str) -> list[str]:
    """The licences that a package's metadata name, each of which must be allowed."""
    known = distribution(name).metadata
    # importlib_metadata, where something has loaded it, raises for what is not there.
    if "License-Expression" in known:
        return re.split(r"\s+AND\s+", known["License-Expression"].replace("(", "").replace(")", ""))
    stated = [
        c.split(" :: ")[-1] for c in known.get_all("Classifier") or () if c.startswith("License :: ")
    ]
    specific = [s for s in stated if s != "OSI Approved"]
    text = " ".join((known.get_all("License") or ["none stated"])[0].split())
    return specific or ["BSD" if _BSD in text else text]


def is_permissive(licence: str) -> bool:
    """Whether one of the alternatives of a licence is on the list."""
    return any(_ALLOWED.fullmatch(one.strip()) for one in re.split(r"\s+OR\s+|/", licence))


def test_what_is_required_has_permissive_licences() -> None:
    required = _required()
    assert {"h5py", "numpy", "llvmlite", "cffi"} <= required
    wrong = {n: licences(n) for n in required if not all(map(is_permissive, licences(n)))}
    assert wrong == {}


def test_other_licences_are_seen() -> None:
    for licence in ("GPL-3.0-or-later", "GNU General Public License v3 (GPLv3)", "LGPL-2.1", "none stated",
                    "Other/Proprietary License"):  # fmt: skip
        assert not is_permissive(licence)
    assert is_permissive("GPL-2.0-only OR MIT") and is_permissive("BSD License")
