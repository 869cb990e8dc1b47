"""Gaits: from the values of a condition to the motion of joints."""

from labrun.gaits.protocol import Gait, make_gait

__all__ = ["Gait", "make_gait"]
