"""Sealed cases for checking a gap diagnosis: simulated benches with physics that the model beside them lacks.

Nothing here is shared with the package under test: the equations, the physics added to them, the integrator and the
file writers are all this folder's own.
"""
