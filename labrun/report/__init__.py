"""Figures of runs, and what `labrun show` and the live display say in the terminal."""

import sys

from labrun import UseCasePackage

sys.modules[__name__].__class__ = UseCasePackage
