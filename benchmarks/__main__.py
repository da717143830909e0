"""`make bench`: every benchmark, one after the other."""

from benchmarks import (
    air,
    alternatives,
    clusters,
    compilation,
    dataset,
    engine,
    paths,
    ptb_studio,
    rendering,
    rlr,
    scenes,
    startup,
    streaming,
)

for benchmark in (
    engine,
    paths,
    alternatives,
    rlr,
    ptb_studio,
    rendering,
    air,
    dataset,
    streaming,
    startup,
    compilation,
    scenes,
    clusters,
):
    benchmark.main()
    print()
