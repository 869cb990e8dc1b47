"""Feedbacks: from the latest samples to what a loop compares with its reference."""
