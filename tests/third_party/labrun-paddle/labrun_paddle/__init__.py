"""A load cell, a triangle-wave gait and an impulse objective for labrun."""
