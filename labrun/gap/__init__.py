"""Where a model and measurements differ, which unmodelled effect causes it, and how far adding it closes the gap."""

from labrun.gap.compare import UnitComparison, UnitDifference, compare_units
from labrun.gap.data_checks import require_informative, with_sound_clocks
from labrun.gap.diagnose import Options, Question, diagnose_dataset
from labrun.gap.diagnosis import (
    By,
    CandidateVerdict,
    Cause,
    ComparedTrace,
    Diagnosis,
    MissingForce,
    Name,
    Place,
    RatedCandidate,
    ResampledNumber,
    RestLaw,
    Shrinkage,
    Sizes,
    Verdict,
)
from labrun.gap.fresh import FreshTest, Prediction, predict_fresh
from labrun.gap.recalibration import fresh_excess
from labrun.gap.robot import (
    CheckedJoint,
    FileCheck,
    JointDiagnosis,
    RobotDiagnosis,
    check_file,
    diagnose_robot,
    parameter_ranges,
    why_not,
)
from labrun.gap.saving import effects_of, recalibrated_only, require_new, save_model, save_with_law

__all__ = [
    "By",
    "CandidateVerdict",
    "Cause",
    "CheckedJoint",
    "ComparedTrace",
    "Diagnosis",
    "FileCheck",
    "FreshTest",
    "JointDiagnosis",
    "MissingForce",
    "Name",
    "Options",
    "Place",
    "Prediction",
    "Question",
    "RatedCandidate",
    "ResampledNumber",
    "RestLaw",
    "RobotDiagnosis",
    "Shrinkage",
    "Sizes",
    "UnitComparison",
    "UnitDifference",
    "Verdict",
    "check_file",
    "compare_units",
    "diagnose_dataset",
    "diagnose_robot",
    "effects_of",
    "fresh_excess",
    "parameter_ranges",
    "predict_fresh",
    "recalibrated_only",
    "require_informative",
    "require_new",
    "save_model",
    "save_with_law",
    "why_not",
    "with_sound_clocks",
]
