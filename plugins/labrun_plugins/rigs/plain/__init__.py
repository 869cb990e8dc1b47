"""Benches that no rig stands for: one without physics, and a robot from an MJCF or URDF file."""
