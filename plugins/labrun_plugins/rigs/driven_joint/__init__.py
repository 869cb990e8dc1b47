"""A body on a pin that a servo swings through an elastic strip, with cameras on both."""
