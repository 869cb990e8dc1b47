"""Closed loops: references, feedbacks and controllers, and what runs them in a trial."""
