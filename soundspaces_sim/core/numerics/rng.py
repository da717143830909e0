"""Random streams: SplitMix64 (Steele, Lea, Flood 2014), one explicit state per subpath or pair.

A stream is keyed by what it is for (seed, position of the point, index of the subpath), never by thread
or by order, and its numbers are read by event, not counted while they are drawn: results do not depend on how work
is divided.
"""

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2**-53


@part(forceinline=True)
def mix64(x: np.uint64) -> np.uint64:
    """SplitMix64's output function: a bijection of 64 bits in which every input bit matters."""
    z = np.uint64(x)
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@kernel(forceinline=True)
def combine(key: np.uint64, value: int | np.uint64) -> np.uint64:
    """A new key from a key and an integer."""
    return mix64(np.uint64(key) ^ (mix64(np.uint64(value) + _GAMMA) + _GAMMA))


@part(forceinline=True)
def uniform(state: np.uint64) -> tuple[np.uint64, float]:
    """Advance a stream: (next state, uniform number in [0, 1))."""
    state = np.uint64(state) + _GAMMA
    return state, np.float64(mix64(state) >> _S11) * _TO_UNIT


@part(forceinline=True)
def event_uniforms(stream: np.uint64, event: int) -> tuple[float, float, float]:
    """The three uniform numbers of a stream that belong to an event (from 1)."""
    at = np.uint64(stream) + np.uint64(3 * event - 3) * _GAMMA
    at, u = uniform(at)
    at, v = uniform(at)
    at, w = uniform(at)
    return u, v, w


@part(forceinline=True)
def hashed_uniform(key: np.uint64, value: int | np.uint64) -> float:
    """A uniform number that is a function of its arguments alone."""
    return np.float64(combine(key, value) >> _S11) * _TO_UNIT


@kernel
def _point_keys(bits: np.ndarray, seed: int, keys: np.ndarray) -> None:
    for i in range(len(keys)):
        key = mix64(np.uint64(seed) + _GAMMA)
        for axis in range(3):
            key = combine(key, bits[i, axis])
        keys[i] = key


def point_keys(points: np.ndarray, seed: int) -> np.ndarray:
    """(N,) uint64 key of every point (N, 3), from its coordinates: the same in any tile."""
    keys = np.empty(len(points), np.uint64)
    _point_keys(np.ascontiguousarray(points, np.float64).view(np.uint64), seed, keys)
    return keys
