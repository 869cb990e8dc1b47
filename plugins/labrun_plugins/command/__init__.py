"""A program that computes a trial instead of measuring it: a solver of finite elements, of flow, of anything."""
