"""Sealed robots: arms and legs of 6 to 12 joints, with effects hidden in one to three of them, and their logs."""
