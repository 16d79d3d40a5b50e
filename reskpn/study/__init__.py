"""Experiments over many runs: what to run, running it, statistics, figures, tables and reports."""
