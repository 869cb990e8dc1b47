"""Gaits: from the values of a condition to the motion of joints."""

from labrun.gaits.protocol import Gait, OscillatingGait, SteerableGait, Steering, make_gait, steering_of

__all__ = ["Gait", "OscillatingGait", "SteerableGait", "Steering", "make_gait", "steering_of"]
