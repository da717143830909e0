"""Learning curves: what is drawn of several seeds."""

import numpy as np
from soundspaces_agents.pictures.curves import _over_seeds


def test_seeds_are_compared_at_the_steps_that_all_have_come_to() -> None:
    runs = [
        [{"steps": 1e6 * s, "spl": 0.2 * s} for s in (1.0, 2.0, 3.0)],
        [{"steps": 1e6 * s, "spl": 0.1 * s} for s in (0.5, 1.5, 2.5)],
    ]
    steps, spl = _over_seeds(runs)
    np.testing.assert_allclose(steps, [0.5, 1.5, 2.5])
    np.testing.assert_allclose(spl, [[0.2, 0.3, 0.5], [0.05, 0.15, 0.25]])
