"""From a plan to trials: devices and clock, settle, tare, record, repeat; and everything that stops what moves."""

from labrun.devices.clock import RealClock, SimulatedClock
from labrun.interrupts import Interrupted
from labrun.runner.asking import AutoConfirm, Person, Scripted
from labrun.runner.bench import Bench, Handle
from labrun.runner.damage import worn_before, worn_specimens
from labrun.runner.doctor import examine_machine, examine_rig, find_devices
from labrun.runner.measurement import Measurement, ObjectiveError, ObjectiveEvaluation
from labrun.runner.motion import MotionMaker, TrialMotion, smooth_move
from labrun.runner.plan import ConditionExcess, JointPeak, Plan, Planner, SearchSpace, SpaceBreak, percent
from labrun.runner.recording import (
    LEAD_S,
    TAIL_S,
    Recorder,
    TrialRecording,
    guard_excesses,
    record_planned,
    within_bounds,
)
from labrun.runner.resolve import EmulatedBench, has_emulator, ports_of, resolve_device
from labrun.runner.rig import Rig
from labrun.runner.safety import LimitReached
from labrun.runner.session import Progress, Session, SilentProgress
from labrun.runner.settle import unsettled
from labrun.runner.tare import untared_objectives
from labrun.runner.until import UntilRecorder

__all__ = [
    "LEAD_S", "TAIL_S", "AutoConfirm", "Bench", "ConditionExcess", "EmulatedBench", "Handle", "Interrupted",
    "JointPeak", "LimitReached", "Measurement", "MotionMaker", "ObjectiveError", "ObjectiveEvaluation", "Person",
    "Plan", "Planner", "Progress", "RealClock", "Recorder", "Rig", "Scripted", "SearchSpace", "Session",
    "SilentProgress", "SimulatedClock", "SpaceBreak", "TrialMotion", "TrialRecording", "UntilRecorder",
    "examine_machine", "examine_rig", "find_devices", "guard_excesses", "has_emulator", "percent", "ports_of",
    "record_planned", "resolve_device", "smooth_move", "unsettled", "untared_objectives", "within_bounds",
    "worn_before", "worn_specimens",
]  # fmt: skip
