"""Figures of runs, fits and diagnoses, in one style."""
