"""Recorded data to identified models, with uncertainty."""
