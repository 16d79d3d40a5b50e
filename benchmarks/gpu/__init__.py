"""A GPU measured by one command: `python -m benchmarks.gpu`, or `make bench-gpu`; docs/benchmarks.md."""
