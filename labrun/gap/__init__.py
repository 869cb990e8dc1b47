"""Where a model and measurements differ, which unmodelled effect causes it, and how far adding it closes the gap."""

from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.diagnosis import (
    By,
    Candidate,
    CandidateVerdict,
    Cause,
    Diagnosis,
    Estimate,
    MissingForce,
    Name,
    Place,
    Shrinkage,
    Sizes,
    Trace,
    Verdict,
)
from labrun.gap.question import Question
from labrun.gap.recalibration import fresh_excess
from labrun.gap.saving import recalibrated_only, require_new, save_model
from labrun.gap.verdict import significant

__all__ = [
    "By",
    "Candidate",
    "CandidateVerdict",
    "Cause",
    "Diagnosis",
    "Estimate",
    "MissingForce",
    "Name",
    "Options",
    "Place",
    "Question",
    "Shrinkage",
    "Sizes",
    "Trace",
    "Verdict",
    "diagnose_dataset",
    "fresh_excess",
    "recalibrated_only",
    "require_new",
    "save_model",
    "significant",
]
