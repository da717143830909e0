"""`make bench`: every benchmark, one after the other."""

from benchmarks import (
    alternatives,
    clusters,
    compilation,
    dataset,
    engine,
    ptb_studio,
    rendering,
    rlr,
    scenes,
    startup,
)

for benchmark in (
    engine,
    alternatives,
    rlr,
    ptb_studio,
    rendering,
    dataset,
    startup,
    compilation,
    scenes,
    clusters,
):
    benchmark.main()
    print()
