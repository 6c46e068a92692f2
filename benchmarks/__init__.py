"""Speed, by pytest-benchmark: ``make benchmarks``; `perf` has the breakdown of a step."""
