"""Population control: keep the weights of a batch of subpaths alike.

Absorption weighs subpaths, and surfaces absorb unequally: after some events a few subpaths that happened to
meet hard surfaces carry nearly all energy, and the variance grows exponentially with time. So every few metres
subpaths of high weight are copied and those of low weight dropped, as in sequential Monte Carlo: subpath i
becomes n_i copies with E[n_i] = N w_i, each weighing 1 / (N w_i) of it, so every expectation is kept. A
subpath's share w_i is the mean over bands of its part of the band's energy, so that no band is starved.
Systematic resampling, only when the effective number of subpaths 1 / sum w_i² has fallen below `_KEEP` of them
(Doucet & Johansen 2009, section 3.5).

Batches are resampled apart and stay independent. Subpaths whose vertices are connected take part only when they
are too long to be connected.
"""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.paths.path_state import Paths, copy_path
from soundspaces_sim.transport.state import Settings

STEP = 6.0  # m of path between two looks at the weights
_KEEP = 0.7


@part
def _in_pool(paths: Paths, settings: Settings, limit: float, i: int) -> bool:
    return not paths.retired[i] and (
        paths.state[i].index >= settings.connected or limit > settings.connection_length
    )


@part
def _shares(paths: Paths, settings: Settings, limit: float) -> tuple[int, float]:
    """Set `paths.share` to each subpath's part w of the pool's energy: (slots, sum of w²)."""
    slots, squares = 0, 0.0
    bands = paths.beta.shape[1]
    paths.share[:] = 0.0
    lit = 0
    for b in range(bands):
        total = 0.0
        for i in range(len(paths.alive)):
            if paths.alive[i] and _in_pool(paths, settings, limit, i):
                total += paths.beta[i, b]
        if total <= 0.0:
            continue
        lit += 1
        for i in range(len(paths.alive)):
            if paths.alive[i] and _in_pool(paths, settings, limit, i):
                paths.share[i] += paths.beta[i, b] / total
    for i in range(len(paths.alive)):
        if _in_pool(paths, settings, limit, i):
            slots += 1
            if lit > 0:
                paths.share[i] /= lit
                squares += paths.share[i] ** 2
    return slots, squares


@part
def resample(paths: Paths, settings: Settings, limit: float, stage: int, u: float, most: int) -> None:
    """Copy heavy subpaths into the slots of light and dead ones, of which at most `most` stay in use; `stage`, from
    1, numbers the calls, `u` is uniform in [0, 1)."""
    slots, squares = _shares(paths, settings, limit)
    if squares <= 0.0 or (slots <= most and 1.0 / squares >= _KEEP * slots):
        return
    surplus = max(slots - most, 0)
    slots -= surplus
    cumulative, taken = 0.0, 0
    for i in range(len(paths.alive)):
        if not _in_pool(paths, settings, limit, i):
            paths.copies[i] = 1
            continue
        cumulative += paths.share[i]
        upto = int(cumulative * slots + u)
        paths.copies[i] = min(upto, slots) - taken
        taken = min(upto, slots)
        if paths.copies[i] > 0:
            for b in range(paths.beta.shape[1]):
                paths.beta[i, b] /= paths.share[i] * slots
        else:
            paths.alive[i] = False
    free = 0
    for i in range(len(paths.alive)):
        for number in range(1, paths.copies[i]):
            while paths.copies[free] > 0:
                free += 1
            copy_path(paths, i, free, stage * len(paths.alive) + number)
            paths.copies[free] = 1
    for i in range(len(paths.alive)):
        if surplus > 0 and paths.copies[i] == 0:
            paths.retired[i] = True
            surplus -= 1
