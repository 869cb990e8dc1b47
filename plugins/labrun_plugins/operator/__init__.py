"""A person at the terminal who places a body by hand and lets it go."""
