"""One episode as it is walked: state, reward, measures. Neither sensors nor Gymnasium are known here."""

from __future__ import annotations

from soundspaces_sim.nav.episodes import Episode
from soundspaces_sim.nav.metrics import Metrics, episode_metrics
from soundspaces_sim.nav.navigation_graph import FORWARD, STOP, World, heading_index
from soundspaces_sim.nav.task import SLACK, SUCCESS, Task


class Walk:
    """An agent on its way. `state` as in `world`; `distance` to the goal, m; `steps` taken, STOP included;
    `collided` in the last step; `over`: stopped, or out of steps."""

    def __init__(self, world: World, episode: Episode, task: Task) -> None:
        self.world, self.episode, self.task = world, episode, task
        self.state = 4 * episode.start + heading_index(episode.heading)
        self.distance = episode.distance
        self.steps = self.collisions = 0
        self.path = 0.0
        self.collided = self.stopped = self.over = False
        self._hops = world.hops[:, episode.goal]
        self._left = int(self._hops[episode.start])

    @property
    def node(self) -> int:
        """Row of the point at which the agent stands."""
        return self.state >> 2

    @property
    def heading(self) -> int:
        """Degrees counter-clockwise from +X."""
        return 90 * (self.state & 3)

    @property
    def silent(self) -> bool:
        """Whether the sound of a semantic episode is over, as SoundSpaces counts: from step `duration` + 1 on."""
        semantic = self.episode.semantic
        return semantic is not None and self.steps > semantic.duration

    def move(self, action: int) -> tuple[float, bool, bool]:
        """(reward, terminated, truncated) of one of the actions STOP, FORWARD, LEFT, RIGHT."""
        world, task = self.world, self.task
        before, left = self.distance, self._left
        self.steps += 1
        self.collided = False
        if action == STOP:
            self.stopped = True
        else:
            state = int(world.moves[self.state, action])
            if action == FORWARD:
                if state == self.state:
                    self.collided = True
                    self.collisions += 1
                else:
                    self.path += world.spacing
            self.state = state
            self._left = int(self._hops[state >> 2])
        # The first step counts from the file's distance, as SoundSpaces' code does.
        self.distance = self._left * world.spacing
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
