"""Least squares on chosen terms of signals."""
