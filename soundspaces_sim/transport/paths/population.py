"""Population control: keep the weights of a batch of walks alike.

Absorption weighs walks, and walls absorb unequally: after some bounces a few walks that happened to meet
hard walls carry nearly all energy, and the variance grows exponentially with time. So every few metres
walks of high weight are copied and walks of low weight dropped, as in sequential Monte Carlo: walk i
becomes n_i copies with E[n_i] = N w_i, each weighing 1 / (N w_i) of it, so every expectation is kept. A
walk's share w_i is the mean over bands of its part of the band's energy, so that no band is starved.
Systematic resampling, only when the effective number of walks 1 / sum w_i^2 has fallen below `_KEEP`.

Batches are resampled apart and stay independent. Walks whose vertices are joined take part only when
they are too long to be joined.
"""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.transport.tables import copy

STEP = 6.0  # m of path between two looks at the weights
_KEEP = 0.7


@part
def _in_pool(walks, settings, limit, i):
    return not walks.retired[i] and (walks.index[i] >= settings.joined or limit > settings.join_length)


@part
def _shares(walks, settings, limit):
    """Set `walks.share` to each walk's part of the pool's energy: (slots, sum of squares)."""
    slots, squares = 0, 0.0
    bands = walks.beta.shape[1]
    walks.share[:] = 0.0
    lit = 0
    for b in range(bands):
        total = 0.0
        for i in range(len(walks.alive)):
            if walks.alive[i] and _in_pool(walks, settings, limit, i):
                total += walks.beta[i, b]
        if total <= 0.0:
            continue
        lit += 1
        for i in range(len(walks.alive)):
            if walks.alive[i] and _in_pool(walks, settings, limit, i):
                walks.share[i] += walks.beta[i, b] / total
    for i in range(len(walks.alive)):
        if _in_pool(walks, settings, limit, i):
            slots += 1
            if lit > 0:
                walks.share[i] /= lit
                squares += walks.share[i] ** 2
    return slots, squares


@part
def resample(walks, settings, limit, u, most):
    """Copy heavy walks into the slots of light and dead ones, of which at most `most` stay in use; `u` uniform
    in [0, 1)."""
    slots, squares = _shares(walks, settings, limit)
    if squares <= 0.0 or (slots <= most and 1.0 / squares >= _KEEP * slots):
        return
    surplus = max(slots - most, 0)
    slots -= surplus
    cumulative, taken = 0.0, 0
    for i in range(len(walks.alive)):
        if not _in_pool(walks, settings, limit, i):
            walks.copies[i] = 1
            continue
        cumulative += walks.share[i]
        upto = int(cumulative * slots + u)
        walks.copies[i] = min(upto, slots) - taken
        taken = min(upto, slots)
        if walks.copies[i] > 0:
            for b in range(walks.beta.shape[1]):
                walks.beta[i, b] /= walks.share[i] * slots
        else:
            walks.alive[i] = False
    free = 0
    for i in range(len(walks.alive)):
        for number in range(1, walks.copies[i]):
            while walks.copies[free] > 0:
                free += 1
            _copy(walks, i, free, number)
            walks.copies[free] = 1
    for i in range(len(walks.alive)):
        if surplus > 0 and walks.copies[i] == 0:
            walks.retired[i] = True
            surplus -= 1


@part
def _copy(walks, source, target, number):
    """Slot `target` becomes a copy of slot `source` with a random stream of its own."""
    walks.index[target] = walks.index[source]
    walks.stream[target] = combine(walks.stream[source], number)
    walks.hero[target] = walks.hero[source]
    walks.state[target] = walks.state[source]
    copy(walks.beta[source], walks.beta[target])
    copy(walks.mixture[source], walks.mixture[target])
    copy(walks.first[source], walks.first[target])
    walks.scattered[target] = walks.scattered[source]
    walks.alive[target] = walks.alive[source]
    walks.retired[target] = False
