"""Loops whose steps are compiled: one kernel that looks, compares, learns and commands, in a dry run and on a bench."""
