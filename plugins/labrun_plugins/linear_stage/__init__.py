"""A stepper stage with a load cell (HX711) on a microcontroller that speaks the line protocol."""
