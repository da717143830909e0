"""`make check` finds the tests of what has changed."""

from __future__ import annotations

from tests.changed import files_for, module_of


def test_files_for_a_module_a_page_and_a_neighbour_are_found() -> None:
    assert files_for([]) == []
    assert "tests/layout/test_reachability.py" in files_for(["soundspaces_sim/layout/reachability.py"])
    assert "tests/transport/test_bsdf.py" not in files_for(["soundspaces_sim/layout/reachability.py"])
    assert "tests/test_readme.py" in files_for(["docs/quickstart.md"])
    assert files_for(["tests/core/test_rows.py"])[0] == "tests/core/test_rows.py"
    assert module_of("neighbours/agents/src/soundspaces_agents/__init__.py") == "soundspaces_agents"
    found = files_for(["neighbours/agents/src/soundspaces_agents/presets.py"])
    assert "neighbours/agents/tests/test_learn.py" in found
