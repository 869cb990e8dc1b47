"""Models of a user's own in MuJoCo: an MJCF file, and a table that maps parameters, signals and sites to it."""
