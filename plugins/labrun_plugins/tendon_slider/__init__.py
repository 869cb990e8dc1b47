"""A slider of two positions, pulled by a tendon and pushed back by a spring, whose switches say where it is."""
