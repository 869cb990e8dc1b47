"""The next experiment: the trials, inside the rig's limits, that best separate what a diagnosis could not."""

from labrun.gap.next.proposal import Proposal
from labrun.gap.next.propose import propose

__all__ = ["Proposal", "propose"]
