"""Figures of runs, and what `labrun show` and the live display say in the terminal."""
