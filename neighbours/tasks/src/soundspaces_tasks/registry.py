"""Tasks by name. One task is a file in this package and a line below.

A task's function takes a `Setting` and returns a `TaskResult`.
"""

from __future__ import annotations

from collections.abc import Mapping

from soundspaces_sim.parts import TableEntry as Entry

TASKS: Mapping[str, Entry] = {
    "reverberation": Entry(
        "soundspaces_tasks.reverberation:run", "T60, C50 and DRR from reverberant speech"
    ),
    "location": Entry(
        "soundspaces_tasks.location:run", "direction and distance of a talker from four channels"
    ),
    "prediction": Entry(
        "soundspaces_tasks.prediction:run", "decays at unseen points from a few references"
    ),
    "dereverberation": Entry(
        "soundspaces_tasks.dereverberation:run", "speech without its late reverberation"
    ),
    "audiogoal": Entry("soundspaces_tasks.audiogoal:run", "agents that find a sound, on episodes"),
}

#: Networks of tasks, which need the extra ``torch``: functions of a task's examples, for one run of training.
NETWORKS: Mapping[str, Entry] = {
    name: Entry(f"soundspaces_tasks.learnt:{name}", "estimates for the test homes")
    for name in ("reverberation", "location", "prediction", "dereverberation")
}
