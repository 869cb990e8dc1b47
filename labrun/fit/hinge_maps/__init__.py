"""Stiffness and damping of hinges over width, length and area of the specimen, as polynomials (chapter 3)."""
