"""What moves the stage: homing, straight moves, and targets of a motion at a steady rate; all within its limits."""

from collections.abc import Callable

import numpy as np

from labrun.devices import Clock, CommandStream, DeviceError, FloatArray, Pacing, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.labline.session import LineSession
from labrun_plugins.linear_stage.reception import Flags, StageState, move_arguments
from labrun_plugins.linear_stage.settings import FASTEST_MM_S, LinearStageSettings

HOMING_MM_S = 5.0
"""Of the firmware."""
_AT_ZERO_MM = 0.01
_SETTLING_S = 0.5
_LOOK_S = 0.05
_PATIENCE = 1.5
_CATCH_UP = 1.05
"""A target is reached a little before the next one is due: what a late command missed is made up."""
_SLOWEST_MM_S = 0.02
_SLACK_MM = 1e-3
"""Targets go out in thousandths of a millimetre."""


class StageMotion:
    """Sends what moves the stage.

    Parameters
    ----------
    state
        Asks the board for its state.
    """

    def __init__(
        self,
        device: str,
        settings: LinearStageSettings,
        clock: Clock,
        session: LineSession,
        state: Callable[[], StageState],
    ) -> None:
        self._device = device
        self._settings = settings
        self._limits = settings.limits
        self._clock = clock
        self._session = session
        self._state = state
        self._token = 0
        self._target_mm: float | None = None
        self._joints = tuple(settings.levers_m)
        self._period_s = 1.0 / settings.command_rate_hz
        self._stream = CommandStream(
            clock, settings.command_rate_hz, self._send,
            idle=session.feed, idle_every_s=settings.watchdog_ms / 1000.0 / 8.0,
        )  # fmt: skip

    @property
    def timing(self) -> Pacing:
        """How evenly set-points have gone out since `restart_timing`."""
        return self._stream.timing

    def restart_timing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._stream.restart_timing()

    def reset(self) -> None:
        """End what went on before."""
        self._stream.end()
        self._target_mm = None

    def start(self) -> None:
        """Begin to feed the board's watchdog."""
        self._stream.start()

    def halt(self) -> None:
        """Send no more targets; any thread, at once, never raises. The watchdog is fed on."""
        self._stream.halt()

    def end(self) -> None:
        """End the thread that sends; never raises."""
        self._stream.end()

    def check(self) -> None:
        """Raise what the sending thread met."""
        self._stream.check()

    def travel(self, to_m: float, speed_m_s: float, token: int) -> None:
        """Start a straight move; see `LinearStage.travel`."""
        if not (np.isfinite(to_m) and np.isfinite(speed_m_s) and speed_m_s > 0):
            raise DeviceError(
                self._device, f"cannot travel to {to_m:g} m at {speed_m_s:g} m/s; the speed is above zero"
            )
        self._require_inside(to_m, to_m, "travel")
        self._require_speed(speed_m_s)
        self._require_homed()
        self._stream.halt()
        self._target_mm = None
        self._move(self._settings.zero_mm + 1e3 * to_m, 1e3 * speed_m_s, token)

    def follow(self, trajectory: Trajectory, start_s: float, token: int) -> None:
        """Start to send targets; see `LinearStage.follow`."""
        if trajectory.joints != self._joints:
            raise DeviceError(
                self._device,
                f"got a motion of {', '.join(trajectory.joints)}, "
                f"but bends {', '.join(self._joints) or 'no joint: name one in joints'}",
            )
        self._limits.require_motion(self._device, trajectory)
        path_m = self._lever_m * trajectory.angle_rad[:, 0]
        self._require_inside(float(path_m.min()), float(path_m.max()), "the motion")
        self._require_speed(float(np.max(np.abs(np.diff(path_m)) / np.diff(trajectory.time_s), initial=0.0)))
        state = self._require_homed()
        self._stream.halt()
        self._token = token
        self._target_mm = state.position_mm
        # A target is where the stage is to be a period later: sent a period early, it is there in time.
        self._stream.follow(trajectory, start_s - self._period_s)

    def home(self, state: StageState) -> None:
        """Seek the end switch unless the stage knows where it is, and go to zero; wait for it."""
        token = self._session.motion_token()
        stroke_mm = self._settings.stroke_mm
        if self._limits.force_n is not None:  # an amplifier that was just switched on takes half a second
            complaint = "feels no force: its load cell's amplifier (HX711) gives nothing"
            self._wait(_feels, _SETTLING_S, complaint, ends=Flags(0))
        if Flags.HOMED not in state.flags:
            self._session.request("HOME", token=token)
            whole_way_s = stroke_mm / HOMING_MM_S
            self._wait(lambda now: Flags.HOMED in now.flags, whole_way_s, "did not find its lower end switch")
        way_s = stroke_mm / self._returning_mm_s
        self._move(self._settings.zero_mm, self._returning_mm_s, token)
        self._wait(self._is_at_zero, way_s, "did not arrive at zero")

    @property
    def _lever_m(self) -> float:
        return self._settings.levers_m[self._joints[0]]

    @property
    def _fastest_mm_s(self) -> float:
        return 1e3 * self._settings.fastest_m_s

    @property
    def _returning_mm_s(self) -> float:
        return min(HOMING_MM_S, self._fastest_mm_s)

    def _is_at_zero(self, state: StageState) -> bool:
        return abs(state.position_mm - self._settings.zero_mm) < _AT_ZERO_MM

    def _wait(
        self,
        arrived: Callable[[StageState], bool],
        way_s: float,
        complaint: str,
        *,
        ends: Flags = Flags.FORCE_LIMIT | Flags.NOT_READY,
    ) -> None:
        """Look until it has arrived; a stage that stands still with one of the flags `ends` never will."""
        if self._limits.force_n is None:  # then it goes on without its load cell
            ends &= ~Flags.NOT_READY
        deadline_s = self._clock.now() + _PATIENCE * way_s + 3.0
        while True:
            self._session.check()
            self._stream.check()
            state = self._state()
            still = Flags.MOVING not in state.flags
            if still and arrived(state):
                return
            if self._clock.now() > deadline_s or (still and ends & state.flags):
                self._session.stop()
                raise self._not_arrived(complaint, state)
            self._clock.sleep(_LOOK_S)

    def _not_arrived(self, complaint: str, state: StageState) -> DeviceError:
        if Flags.NOT_READY in state.flags:
            hint = (
                "check the supply and the wires DOUT and SCK of the load cell's amplifier; then labrun resume"
            )
        else:
            hint = "look for an obstacle, a loose switch or a motor without supply; then labrun resume"
        force = ": the force limit stopped it" if Flags.FORCE_LIMIT in state.flags else ""
        return DeviceError(
            self._device,
            f"{complaint}{force}; it stands at {state.position_mm:.3f} mm by its own count",
            hint=hint,
        )

    def _send(self, angle_rad: FloatArray) -> None:
        """Send one target, by the stream's thread; the next is due a period later."""
        target_mm = self._settings.zero_mm + 1e3 * self._lever_m * float(angle_rad[0])
        before_mm = self._target_mm
        if before_mm is None:  # halted
            return
        way_mm = abs(target_mm - before_mm)
        if way_mm < 0.5 * _SLACK_MM:
            self._session.feed()
            return
        speed_mm_s = max(_CATCH_UP * way_mm / self._period_s, _SLOWEST_MM_S)
        self._target_mm = target_mm
        self._move(target_mm, min(speed_mm_s, self._fastest_mm_s), self._token, wait=False)

    def _move(self, target_mm: float, speed_mm_s: float, token: int, *, wait: bool = True) -> None:
        """Send one move: the last look at the limits before the wire."""
        position_m = 1e-3 * (target_mm - self._settings.zero_mm)
        self._require_inside(position_m, position_m, "a target")
        low_mm, high_mm = (self._settings.zero_mm + 1e3 * end for end in self._settings.travel_m)
        arguments = move_arguments(min(max(target_mm, low_mm), high_mm), speed_mm_s)
        if wait:
            self._session.request("MV", *arguments, token=token)
        else:
            self._session.post("MV", *arguments, token=token)

    def _require_inside(self, least_m: float, most_m: float, what: str) -> None:
        low, high = self._settings.travel_m
        if not (least_m >= low - 1e-3 * _SLACK_MM and most_m <= high + 1e-3 * _SLACK_MM):
            worst = most_m if most_m > high else least_m
            raise LimitExceededError(
                self._device, f"{what} to {worst:g} m leaves {low:g} ... {high:g} m; nothing was sent",
                hint="change the motion, or limits.travel_m and stroke_mm in the experiment file",
            )  # fmt: skip

    def _require_speed(self, speed_m_s: float) -> None:
        most_mm_s = self._fastest_mm_s
        if 1e3 * speed_m_s > most_mm_s * (1 + 1e-9):
            raise LimitExceededError(
                self._device, f"speed {1e3 * speed_m_s:.4g} mm/s is above {most_mm_s:g} mm/s; nothing was sent",
                hint=f"move more slowly, or raise limits.speed_m_s (the board's own limit is {FASTEST_MM_S:g} mm/s)",
            )  # fmt: skip

    def _require_homed(self) -> StageState:
        state = self._state()
        if Flags.HOMED not in state.flags:
            raise DeviceError(
                self._device,
                "is not homed: it does not know where it is, so it does not move",
                hint="set home_on_open = true, with nothing in its way to the lower end switch",
            )
        return state


def _feels(state: StageState) -> bool:
    return Flags.NOT_READY not in state.flags
