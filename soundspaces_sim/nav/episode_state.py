"""State of an episode under way: pose, reward, measures. Independent of sensors and of Gymnasium."""

from __future__ import annotations

from soundspaces_sim.nav.episodes import Episode
from soundspaces_sim.nav.metrics import Metrics, episode_metrics
from soundspaces_sim.nav.navigation_graph import FORWARD, STOP, NavigationGraph, heading_index
from soundspaces_sim.nav.task import SLACK, SUCCESS, TaskOptions


class EpisodeState:
    """State of an episode. `pose`: 4 * node + heading, as in `NavigationGraph`; `distance` to the goal, m; `steps`
    taken, STOP included; `collided` in the last step; `over`: stopped, or out of steps."""

    def __init__(self, graph: NavigationGraph, episode: Episode, task: TaskOptions) -> None:
        self.graph, self.episode, self.task = graph, episode, task
        self.pose = 4 * episode.start + heading_index(episode.heading)
        self.distance = episode.distance
        self.steps = self.collisions = 0
        self.path = 0.0
        self.collided = self.stopped = self.over = False
        self._hops = graph.hops[:, episode.goal]
        self._left = int(self._hops[episode.start])

    @property
    def node(self) -> int:
        """Row of the point at which the agent stands."""
        return self.pose >> 2

    @property
    def heading(self) -> int:
        """Degrees counter-clockwise from +X."""
        return 90 * (self.pose & 3)

    @property
    def silent(self) -> bool:
        """Whether the sound of a semantic episode is over, as SoundSpaces counts: from step `duration` + 1 on."""
        semantic = self.episode.semantic
        return semantic is not None and self.steps > semantic.duration

    def move(self, action: int) -> tuple[float, bool, bool]:
        """(reward, terminated, truncated) of one of the actions STOP, FORWARD, LEFT, RIGHT."""
        graph, task = self.graph, self.task
        before, left = self.distance, self._left
        self.steps += 1
        self.collided = False
        if action == STOP:
            self.stopped = True
        else:
            pose = int(graph.moves[self.pose, action])
            if action == FORWARD:
                if pose == self.pose:
                    self.collided = True
                    self.collisions += 1
                else:
                    self.path += graph.spacing
            self.pose = pose
            self._left = int(self._hops[pose >> 2])
        # The first step counts from the file's distance, as SoundSpaces' code does.
        self.distance = self._left * graph.spacing
        won = self.stopped and self.distance <= task.success_radius
        nearer = left - self._left if task.distance_reward == "step" else before - self.distance
        truncated = not self.stopped and self.steps >= task.max_steps
        self.over = self.stopped or truncated
        return SLACK + nearer + SUCCESS * won, self.stopped, truncated

    def metrics(self) -> Metrics:
        """The measures so far."""
        return episode_metrics(
            start_distance=self.episode.distance, distance=self.distance, path=self.path, actions=self.steps,
            fewest=self.episode.actions, collisions=self.collisions, stopped=self.stopped,
            success_radius=self.task.success_radius,
        )  # fmt: skip
