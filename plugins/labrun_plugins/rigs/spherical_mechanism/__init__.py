"""The two-axis spherical mechanism of chapters 2 and 4, and the stabiliser built on it."""
