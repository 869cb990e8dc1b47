"""Makes the golden lines importable."""
