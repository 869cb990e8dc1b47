"""Controllers from a fitted transfer function: design, margins of the loop as it runs, predicted closed loop."""
