"""Runs on disk: written so that no crash costs more than the trial in flight, and readable without labrun."""
