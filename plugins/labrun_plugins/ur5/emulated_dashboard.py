"""The emulated dashboard server: a line in, a line out."""

from labrun.devices.emulation import EmulatorLog, Faults
from labrun_plugins.ur5.emulated_arm import PAUSED, PLAYING, EmulatedArm

BANNER = "Connected: Universal Robots Dashboard Server"
_ROBOT_MODES = {3: "POWER_OFF", 7: "RUNNING"}
_SAFETY_MODES = {1: "NORMAL", 3: "PROTECTIVE_STOP", 5: "SAFEGUARD_STOP", 7: "ROBOT_EMERGENCY_STOP"}
_SERIAL = "20155300001"
_BRAKE_M_S2 = 2.0
_ACTIONS = ("stop", "pause", "play", "unlock protective stop")
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect its cause before unlocking"
)


def reply(
    command: str, arm: EmulatedArm, faults: Faults, log: EmulatorLog, version: str, now_s: float
) -> str:
    """Return the answer to one line, and do what it asks for."""
    told = _told(command, arm, faults, version)
    if told is not None:
        return told
    if command in _ACTIONS and faults.active("local-mode"):
        log.note("ignored", what=f"dashboard {command}", why="local control")
        return f"Failed to execute: {command}"
    if command == "stop":
        log.note("stop", how="dashboard", position_m=arm.position_m())
    return _done(command, arm, now_s)


def _done(command: str, arm: EmulatedArm, now_s: float) -> str:
    """Do what a command asks for, and return the answer."""
    answer = f"could not understand: '{command[:80]}'"
    if command == "stop":
        if arm.runtime in (PLAYING, PAUSED):
            arm.stop_program(_BRAKE_M_S2, now_s)
        answer = "Stopped"
    elif command == "pause" and arm.runtime == PLAYING:
        arm.stop_program(_BRAKE_M_S2, now_s, paused=True)
        answer = "Pausing program"
    elif command == "unlock protective stop":
        answer = "Protective stop releasing" if arm.unlock(now_s) else _TOO_EARLY
    elif command in _ACTIONS:
        answer = f"Failed to execute: {command}"
    return answer


def _told(command: str, arm: EmulatedArm, faults: Faults, version: str) -> str | None:
    """Return the answer to a question; None if it is none."""
    remote = not faults.active("local-mode")
    state = {PLAYING: "PLAYING", PAUSED: "PAUSED"}.get(arm.runtime, "STOPPED")
    questions = {
        "robotmode": f"Robotmode: {_ROBOT_MODES[arm.robot_mode]}",
        "safetymode": f"Safetymode: {_SAFETY_MODES[arm.safety_mode]}",
        "safetystatus": f"Safetystatus: {_SAFETY_MODES[arm.safety_mode]}",
        "programState": f"{state} labrun_move",
        "running": f"Program running: {'true' if arm.runtime == PLAYING else 'false'}",
        "PolyscopeVersion": f"URSoftware {version} (Jan 01 2023)",
        "get serial number": _SERIAL,
        "get robot model": "UR5",
        "close safety popup": "closing safety popup",
        "quit": "Disconnected",
    }
    if version.startswith("5."):
        questions["is in remote control"] = "true" if remote else "false"
    return questions.get(command)
