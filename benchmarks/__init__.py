"""Benchmarks: `python -m benchmarks list | run NAME … | report`, and `make bench` for all of them.

`speed` asks how long things take, `accuracy` how far they are from known answers and measured rooms,
`experiments` why. Each of their modules is one benchmark: its docstring says the question, the method, what is
amortised and how long it takes; ``run`` returns tables. A run is stored
in `results/NAME.json`, and RESULTS.md is written from these files alone. Benchmarks that carry no claim any more
are in the history. `pictures` makes pictures and sounds of the documentation, `tools` is what all of them share.
"""
