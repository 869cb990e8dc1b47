"""Which trials come next: those that separate what a diagnosis could not; before any data, those that show most."""

from labrun.gap.next.plan import TrialPlan, plan_trials
from labrun.gap.next.proposal import Proposal, propose
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.trials import free_place, require_experiment_place

__all__ = [
    "Proposal",
    "RunBench",
    "TrialPlan",
    "free_place",
    "plan_trials",
    "propose",
    "require_experiment_place",
]
