"""Fins on curved beams that buckle to one side: wings in air and water, and swimmers of two fins (section 7)."""
