"""The curved beam of chapter 7, between a linear stage and a load cell."""
