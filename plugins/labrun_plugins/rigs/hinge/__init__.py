"""The hinge of chapter 3: a body that swings freely on a sheet of plastic."""
