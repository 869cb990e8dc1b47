"""Rigs of the source work, a folder each: scene, models, fits of its own, and a README with its sources."""
