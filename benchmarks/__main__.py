"""`make bench`: every benchmark, one after the other."""

from benchmarks import engine, ptb_studio

engine.main()
print()
ptb_studio.main()
