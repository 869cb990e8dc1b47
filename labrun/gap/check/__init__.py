"""Checking the diagnosis on cases whose answers are sealed until it has spoken."""

from labrun.gap.check.checking import check
from labrun.gap.check.result import Checked

__all__ = ["Checked", "check"]
