"""Simulated benches: what the stand-in devices of a dry run look at and act on."""
