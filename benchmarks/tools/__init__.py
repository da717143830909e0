"""What benchmarks share: records of runs, clocks, scenes."""
