"""What a study compares: kinds of agents, conditions that they are tested in, orderings that the paper found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import (
    BASELINES,
    POINTGOAL,
    EarMode,
    TaskName,
    nearest_name as nearest,
)

SIGMAS = (0.5, 1.0, 1.5)  # m, of the GPS
DEFAULT_SENSORS = ("spectrogram", "depth", "collision")
LEARNT_IN, LEARNT_IN_MANY, TESTED_IN = "train", "train_varied", "test"  # sets of episodes
WALKS = (100, 250, 1000)  # per point: how good must a dataset be?


@dataclass(frozen=True)
class Acoustics:
    """Which responses are heard: of datasets with `walks` per point (None: the study's), as `renderer`, a name
    of `rendering.renderers`, makes them (None: the datasets'). `tested`: the acoustics in which those are tested
    that were trained in these, besides the study's own."""

    name: str
    about: str
    walks: int | None = None
    renderer: str | None = None
    tested: str = ""


_WALKS = "walks-{}"
_FINEST = _WALKS.format(max(WALKS))
OWN = Acoustics("own", "the study's datasets")
ACOUSTICS = {
    a.name: a
    for a in (
        OWN,
        *(Acoustics(_WALKS.format(n), f"{n:,} walks a point", walks=n, tested=_FINEST) for n in WALKS),
        Acoustics("direct", "the direct sound alone", renderer="direct", tested="direct"),
        Acoustics("paper", "the paper's rendering", renderer="paper", tested="paper"),
    )
}


@dataclass(frozen=True)
class Variant:
    """One kind of agent that is trained and compared. `noisy_gps`: is also tested with noise in its GPS;
    `varied`: is trained with many sounds instead of one, and tested with those and with others; `acoustics`: it
    is trained in; `reference`: is tested in all acoustics that others of the study are."""

    name: str
    task: TaskName
    sensors: tuple[str, ...]
    about: str
    method: str = "ppo"
    noisy_gps: bool = False
    varied: bool = False
    ears: EarMode = "binaural"
    acoustics: str = OWN.name
    reference: bool = False

    @property
    def episodes(self) -> str:
        """The set of episodes that it is trained with."""
        return LEARNT_IN_MANY if self.varied else LEARNT_IN


#: By PPO, in the order in which they are trained: what matters most first.
_BY_PPO = {
    variant.name: variant
    for variant in (
        Variant("AG", "AudioGoal", DEFAULT_SENSORS, "AudioGoal", reference=True),
        Variant("PG", "PointGoal", (POINTGOAL, "depth", "collision"), "PointGoal", noisy_gps=True),
        Variant(
            "APG", "AudioPointGoal", (*DEFAULT_SENSORS, POINTGOAL), "AudioPointGoal", noisy_gps=True
        ),
        Variant(
            "AG-intensity", "AudioGoal", ("intensity", "depth", "collision"), "hears loudness alone"
        ),
        Variant("AG-blind", "AudioGoal", ("spectrogram", "collision"), "sees nothing"),
        Variant("AG-varied", "AudioGoal", DEFAULT_SENSORS, "trained with 73 sounds", varied=True),
        Variant(
            "APG-varied",
            "AudioPointGoal",
            (*DEFAULT_SENSORS, POINTGOAL),
            "trained with 73 sounds",
            varied=True,
        ),
        Variant("AG-mono", "AudioGoal", DEFAULT_SENSORS, "both ears hear their mean", ears="mono"),
        *(
            Variant(
                f"AG-{a.name}", "AudioGoal", DEFAULT_SENSORS, f"trained with {a.about}", acoustics=a.name
            )
            for a in ACOUSTICS.values()
            if a != OWN
        ),
    )
}
_TAUGHT = "-dagger"
#: All of them; ``<name>-dagger`` is taught by the oracle, with a tenth of the steps.
VARIANTS = _BY_PPO | {
    variant.name + _TAUGHT: replace(variant, name=variant.name + _TAUGHT, method="dagger")
    for variant in _BY_PPO.values()
}
PPO_VARIANTS = tuple(_BY_PPO)


@dataclass(frozen=True)
class Condition:
    """How an agent is tested: on which set of `episodes`, with how much noise in its GPS (m), in which
    `acoustics`."""

    name: str = "plain"
    episodes: str = TESTED_IN
    sigma: float = 0.0
    acoustics: str = OWN.name


PLAIN = Condition()
NOISY = {sigma: Condition(f"gps-{sigma:g}", sigma=sigma) for sigma in SIGMAS}
HEARD, UNHEARD = Condition("heard", "test_heard"), Condition("unheard", "test_unheard")
#: Tested in other acoustics than the study's own.
IN = {
    name: Condition(f"in-{name}", acoustics=name)
    for name in dict.fromkeys(a.tested for a in ACOUSTICS.values() if a.tested)
}
CONDITIONS = {c.name: c for c in (PLAIN, *NOISY.values(), HEARD, UNHEARD, *IN.values())}


@dataclass(frozen=True)
class Trial:
    """One evaluation: a baseline, or one run of an arm, in a condition."""

    agent: str
    seed: int
    condition: Condition = PLAIN


def trials_of(runs: Iterable[tuple[Variant, int]]) -> list[Trial]:
    """What is evaluated: baselines, and every run in its conditions."""
    runs = list(runs)
    out = [Trial(name, 0) for name in BASELINES]
    tested = {ACOUSTICS[variant.acoustics].tested for variant, _ in runs}
    for variant, seed in runs:
        here = tested if variant.reference else {ACOUSTICS[variant.acoustics].tested}
        conditions = (
            (HEARD, UNHEARD)
            if variant.varied
            else (PLAIN, *(NOISY.values() if variant.noisy_gps else ()))
        )
        conditions += tuple(condition for name, condition in IN.items() if name in here)
        out += [Trial(variant.name, seed, condition) for condition in conditions]
    return out


def heard_in(runs: Iterable[tuple[Variant, int]]) -> dict[str, set[str]]:
    """Sets of episodes by the acoustics in which they are walked; those of the study's own first."""
    runs = list(runs)
    out = {OWN.name: {LEARNT_IN, TESTED_IN}}
    for variant, _ in runs:
        out.setdefault(variant.acoustics, set()).add(variant.episodes)
    for trial in trials_of(runs):
        out.setdefault(trial.condition.acoustics, set()).add(trial.condition.episodes)
    return out


def without_twins(variants: Iterable[str], walks: int) -> tuple[str, ...]:
    """The same without those that are trained with as many walks as the study's own datasets have: AG is."""
    return tuple(name for name in variants if ACOUSTICS[VARIANTS[name].acoustics].walks != walks)


def choose_variants(names: Sequence[str]) -> list[Variant]:
    """Arms by name. Raises `ConfigError`."""
    for name in names:
        if name not in VARIANTS:
            raise ConfigError(
                f"agents: '{name}' is not one of {', '.join(VARIANTS)}{nearest(name, VARIANTS)}"
            )
    return [VARIANTS[name] for name in names]


@dataclass(frozen=True)
class Claim:
    """SPL of `better` (agent, condition) above that of `worse`; `about` what that means; `paper`: their SPL in
    its table 1 or 2 (Replica), where it has them."""

    better: tuple[str, Condition]
    worse: tuple[str, Condition]
    about: str
    paper: str = ""


_CLAIMS = (
    Claim(("AG", PLAIN), ("EarFollower", PLAIN), "a learnt agent beats following the louder ear"),
    Claim(("EarFollower", PLAIN), ("Random", PLAIN), "ears alone beat chance"),
    Claim(("AG", PLAIN), ("PG", PLAIN), "sound is worth more than GPS", "0.756, 0.601"),
    Claim(("APG", PLAIN), ("PG", PLAIN), "sound helps an agent that has GPS", "0.709, 0.601"),
    Claim(("AG", PLAIN), ("APG", PLAIN), "GPS does not help an agent that hears", "0.756, 0.709"),
    Claim(
        ("PG", PLAIN), ("PG", NOISY[0.5]), "PointGoal falls with noise of 0.5 m in the GPS", "figure 6"
    ),
    Claim(("PG", NOISY[0.5]), ("PG", NOISY[1.0]), "further with 1 m", "figure 6"),
    Claim(("PG", NOISY[1.0]), ("PG", NOISY[1.5]), "and with 1.5 m", "figure 6"),
    Claim(("AG", PLAIN), ("PG", NOISY[0.5]), "sound replaces a GPS that errs by 0.5 m", "figure 6"),
    Claim(("APG", PLAIN), ("APG", NOISY[1.5]), "noise in the GPS harms an agent that hears, too"),
    Claim(
        ("AG", PLAIN), ("AG-intensity", PLAIN), "the spectrogram says more than loudness", "0.756, 0.291"
    ),
    Claim(("AG", PLAIN), ("AG-blind", PLAIN), "depth helps an agent that hears", "0.756, 0.673"),
    Claim(
        ("AG-varied", HEARD),
        ("AG-varied", UNHEARD),
        "sounds heard in training are easier",
        "0.645, 0.454",
    ),
    Claim(("APG-varied", HEARD), ("APG-varied", UNHEARD), "also with GPS", "0.724, 0.707"),
    Claim(
        ("APG-varied", UNHEARD), ("AG-varied", UNHEARD), "GPS helps with unheard sounds", "0.707, 0.454"
    ),
    Claim(("AG", PLAIN), ("AG-mono", PLAIN), "two ears are better than one"),
    Claim(("AG", PLAIN), ("AG-direct", IN["direct"]), "a room's answer is worth more than silence"),
    Claim(
        ("AG", PLAIN),
        ("AG-direct", PLAIN),
        "training with reverberation helps in reverberant scenes",
    ),
    Claim(
        ("AG", PLAIN), ("AG", IN["direct"]), "an agent trained with reverberation does worse without it"
    ),
    Claim(("AG", PLAIN), ("AG-paper", IN["paper"]), "our rendering is the easier to walk by"),
    Claim(
        ("AG", PLAIN),
        ("AG-paper", PLAIN),
        "an agent trained with the paper's rendering does worse with ours",
    ),
    Claim(("AG-paper", IN["paper"]), ("AG", IN["paper"]), "and the other way round"),
    *(
        Claim(
            (f"AG-walks-{many}", IN[_FINEST]),
            (f"AG-walks-{few}", IN[_FINEST]),
            f"{many:,} walks a point teach more than {few:,}",
        )
        for few, many in combinations(WALKS, 2)
    ),
)


def claims(walks: int | None = None) -> Iterator[Claim]:
    """Of agents by PPO, then of those by DAgger. `walks`: of the study's own datasets, whose agent is AG."""
    twin = f"AG-{_WALKS.format(walks)}"
    for suffix in ("", _TAUGHT):
        for claim in _CLAIMS:
            (a, of_a), (b, of_b) = claim.better, claim.worse
            if suffix and {a, b} <= set(BASELINES):
                continue
            a, b = ("AG" if name == twin else name for name in (a, b))
            names = (name if name in BASELINES else name + suffix for name in (a, b))
            yield replace(claim, better=(next(names), of_a), worse=(next(names), of_b))
