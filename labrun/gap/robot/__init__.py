"""A robot's joints one by one: each as a model of its own, the motion of the others prescribed as it was measured."""

from labrun.gap.robot.between_logs import differences_between_logs
from labrun.gap.robot.correction_choice import Written
from labrun.gap.robot.diagnose import diagnose_robot
from labrun.gap.robot.diagnosis import JointDiagnosis, RobotDiagnosis
from labrun.gap.robot.file_check import CheckedJoint, FileCheck, check_file
from labrun.gap.robot.one_joint import why_not
from labrun.gap.robot.other_fit import FittedValue, JudgedJoint, JudgedValue, OtherFit, Quantity, judge_fit
from labrun.gap.robot.ranges import parameter_ranges

__all__ = [
    "CheckedJoint", "FileCheck", "FittedValue", "JointDiagnosis", "JudgedJoint", "JudgedValue", "OtherFit",
    "Quantity", "RobotDiagnosis", "Written", "check_file", "diagnose_robot", "differences_between_logs", "judge_fit",
    "parameter_ranges", "why_not",
]  # fmt: skip
