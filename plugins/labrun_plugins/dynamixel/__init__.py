"""Dynamixel servos of the X series, over Protocol 2.0."""
