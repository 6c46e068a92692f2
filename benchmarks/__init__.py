"""Speed, by pytest-benchmark: ``make benchmarks``; `spoofgym perf` has the breakdown of a step."""
