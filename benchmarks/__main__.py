"""`make bench`: every benchmark, one after the other."""

from benchmarks import alternatives, engine, ptb_studio

engine.main()
print()
alternatives.main()
print()
ptb_studio.main()
