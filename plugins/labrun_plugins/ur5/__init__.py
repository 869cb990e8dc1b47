"""Universal Robots UR5 and UR5e as a carriage along a straight line."""
