"""Closed chains: bodies on hinges, one loop among them, read from a table and compiled."""
