"""References: what a loop's feedback should be over time."""
