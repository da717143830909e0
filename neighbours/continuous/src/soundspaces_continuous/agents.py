"""Baselines in continuous space: an oracle, and one that goes where its ears say."""

from __future__ import annotations

import math

import numpy as np
import scipy.fft

from soundspaces_continuous.state import ContinuousState
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import FORWARD, LEFT, RIGHT, STOP

Observation = dict[str, np.ndarray]
EAR_S = 0.0875 / 343.0  # radius of a head over the speed of sound


class ContinuousOracle:
    """Follows the shortest way to the nearest goal, which it knows."""

    name = "ContinuousOracle"

    def reset(self, state: ContinuousState, seed: int) -> None:
        """A new episode begins."""
        del seed
        self.state = state

    def act(self, observation: Observation) -> int:
        """The next action."""
        del observation
        return self.state.oracle_action()


def interaural_delay(ears: np.ndarray, rate: int) -> tuple[float, float]:
    """(s, height of its peak) by which sound reaches the left ear before the right, at most that of a head: the
    peak of
    the generalised cross-correlation with phase transform (Knapp & Carter 1976) of ears (2, n), on a grid of 1/16
    sample. The height is 1 for one wave from one direction, and nearly 0 for noise of its own at each ear."""
    n = 2 * ears.shape[1]
    left, right = scipy.fft.rfft(ears.astype(float), n)
    cross = right * left.conj()
    size = np.abs(cross)
    floor = 1e-3 * float(size.max(initial=0.0))
    phase = np.where(size > floor, cross / np.maximum(size, 1e-300), 0.0)
    over = 16
    whole = scipy.fft.irfft(phase, over * n) * over
    reach = math.ceil(
        4.0 * EAR_S * rate * over
    )  # a delay goes to 2.6 head radii at most (Woodworth 1938)
    lags = np.arange(-reach, reach + 1)
    values = whole[lags]
    k = int(values.argmax())
    used = max(float((size > floor).mean()), 1e-9)
    return float(lags[k]) / (over * rate), float(values[k]) / used


def direction_of(delay: float) -> float:
    """rad, left positive, within ±90 degrees: Woodworth's sphere, delay = a / c (θ + sin θ), inverted."""
    most = EAR_S * (0.5 * math.pi + 1.0)
    target = min(max(delay, -most), most) / EAR_S
    angle = 0.5 * target
    for _ in range(20):
        angle -= (angle + math.sin(angle) - target) / (1.0 + math.cos(angle))
        angle = min(max(angle, -0.5 * math.pi), 0.5 * math.pi)
    return angle


class DirectionFollower:
    """Turns to the direction of arrival, by interaural delay where one wave prevails and by level where none does,
    and
    walks on; front and back, which ears at rest cannot tell apart, by whether it gets louder. After a bump it turns
    to a random side and takes some steps. It knows when it has arrived, as the other baselines do. It hears
    `audiogoal`. `clear`: height of the correlation's peak from which a delay is believed."""

    name = "DirectionFollower"

    def __init__(self, rate: int = 16000, clear: float = 0.12, threshold_db: float = 1.0) -> None:
        self.rate, self.clear, self.threshold_db = rate, clear, threshold_db

    def reset(self, state: ContinuousState, seed: int) -> None:
        """A new episode begins."""
        self.state, self.rng = state, np.random.default_rng(seed)
        self._plan: list[int] = []
        self._level, self._fading = -math.inf, 0

    def act(self, observation: Observation) -> int:
        """The next action. Raises `ConfigError` for an agent without `audiogoal`."""
        if "audiogoal" not in observation:
            raise ConfigError(
                f"{self.name}: add the sensor 'audiogoal'; there are {', '.join(observation)}"
            )
        if self.state.distance < self.state.options.success_distance:
            return STOP
        ears = observation["audiogoal"]
        power = np.maximum((ears.astype(float) ** 2).mean(axis=1), 1e-30)
        level = 10.0 * math.log10(float(power.sum()))
        quiet = level < -150.0
        if self.state.collided:
            side = int(self.rng.choice((LEFT, RIGHT)))
            self._plan = [side] * int(self.rng.integers(2, 8)) + [FORWARD] * 3
            self._fading = 0
        elif not self._plan:
            self._plan = [FORWARD] if quiet else self._listen(ears, power, level)
        return self._plan.pop(0)

    def _listen(self, ears: np.ndarray, power: np.ndarray, level: float) -> list[int]:
        self._fading = self._fading + 1 if level < self._level - 0.2 else 0
        self._level = level
        turns = round(math.pi / self.state.options.turn)
        if self._fading >= 4:  # it has been getting quieter: what seems ahead is behind
            self._fading = 0
            return [int(self.rng.choice((LEFT, RIGHT)))] * turns + [FORWARD]
        delay, peak = interaural_delay(ears, self.rate)
        if peak >= self.clear:
            off = direction_of(delay)
        else:
            ratio = 10.0 * math.log10(power[0] / power[1])
            off = (
                math.copysign(2.0 * self.state.options.turn, ratio)
                if abs(ratio) > self.threshold_db
                else 0.0
            )
        steps = round(abs(off) / self.state.options.turn)
        return [LEFT if off > 0.0 else RIGHT] * steps + [FORWARD] * 2


CONTINUOUS_BASELINES: dict[str, type[ContinuousOracle | DirectionFollower]] = {
    agent.name: agent for agent in (ContinuousOracle, DirectionFollower)
}
