"""Pictures and sounds of the documentation, made anew; no benchmarks."""
