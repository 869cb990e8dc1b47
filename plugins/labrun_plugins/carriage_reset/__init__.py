"""A servo and pulley that pull a carriage back to its start between trials."""
