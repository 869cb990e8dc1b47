"""A servo that pulls a slider by a tendon, and two switches that say where it stands."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, FloatArray, Health, Identity, Remark
from labrun_plugins.arduino_servo.servo_board import BoardDevice, ServoBoard
from labrun_plugins.tendon_slider.changeover import Changeover
from labrun_plugins.tendon_slider.settings import KIND, SWITCHES, TendonSliderSettings


class TendonSlider(BoardDevice):
    """A mechanism of two states that puts itself into that which the trial's condition names.

    The servo only pulls: a spring brings the slider back. A trial begins when the switch of the wanted state has closed
    and that of the other one is open; until then, and if it stays so, nothing else moves.

    Parameters
    ----------
    name, settings, context
        As for every device.
    """

    Settings: ClassVar[type[DeviceSettings]] = TendonSliderSettings
    kind: ClassVar[str] = KIND

    def __init__(self, name: str, settings: TendonSliderSettings, context: DeviceContext) -> None:
        self._settings = settings
        self._clock = context.clock
        board = ServoBoard(
            name,
            settings,
            context.clock,
            kind=KIND,
            windows_us={settings.channel: settings.pulse_window_us()},
            rest_us={settings.channel: settings.released_us},
            pulses_of=self._pulses,
        )
        super().__init__(name, settings, board)
        self._change = Changeover(name, settings, context.clock, self._switches, board.safe_stop)

    def open(self) -> None:
        """Connect; the servo gets no pulse yet.

        Raises DeviceError: no port, no answer, other firmware, or a firmware without its two switches.
        """
        self._change.withdraw()
        super().open()
        self._switches()

    def identify(self) -> Identity:
        """Say what answered, and what stands between state and pulse."""
        hello, keys = self._board.hello, self._settings
        return Identity(
            "slider on a tendon, Arduino",
            firmware=f"{hello.kind} {hello.firmware}",
            details={
                "kind": hello.kind,
                "watchdog_ms": str(keys.watchdog_ms),
                keys.states[0]: f"tendon slack, {keys.released_us} us, switch 0",
                keys.states[1]: f"tendon tight, {keys.pulled_us} us, switch 1",
            },
        )

    def health(self) -> Health:
        """Ask the board for its state, and look whether the slider is still where it was verified to be."""
        health = super().health()
        complaint = self._change.complaint() if health.ok else None
        return health if complaint is None else Health(ok=False, notes=(*health.notes, complaint))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Begin to move into the state that the coming trial's condition names; returns at once.

        Raises DeviceError: no such state, no answer, or the watchdog expired.
        """
        token = self._board.motion_token()
        from_pulled = self._settings.pulled(self._board.sent_us()[self._settings.channel])
        if self._change.want(condition):
            self._board.follow(self._change.path(from_pulled), self._clock.now(), token)

    def arrived(self) -> bool:
        """Tell whether the switches say that the wanted state is reached; DeviceError if it takes too long."""
        self._board.check()
        return self._change.arrived()

    def safe_stop(self) -> None:
        """Have the board stop the servo where it is; what was asked for is no longer under way."""
        super().safe_stop()
        self._change.withdraw()

    def close(self) -> None:
        """Stop, turn the watchdog off so that it has nothing to tell, and disconnect. The servo goes on holding."""
        super().close()
        self._change.withdraw()

    def examine(self) -> list[Remark]:
        """Look at firmware, channels, rate, watchdog and switches, for `labrun doctor --hardware`."""
        closed = self._switches()
        text = ", ".join(
            f"{name} {'closed' if switch else 'open'}"
            for name, switch in zip(self._settings.states, closed, strict=True)
        )
        advice = "exactly one is closed at rest: look at wiring and springs"
        switches = Remark.judged(sum(closed) == 1, self.name, f"switches: {text}", advice, "problem")
        return [*super().examine(), switches]

    def _switches(self) -> Sequence[bool]:
        """Return which switches are closed."""
        reply = self._board.session.request("SW")
        if len(reply) != SWITCHES or not set(reply) <= {"0", "1"}:
            raise DeviceError(
                self.name,
                f"its switches answer {','.join(reply) or 'nothing'!r}; two of 0 or 1 were expected",
                hint="flash labservo.ino with SWITCH_PINS: see the README of tendon-slider",
            )
        return [bit == "1" for bit in reply]

    def _pulses(self, pulled: FloatArray) -> Mapping[int, int]:
        """Return the pulse width of one set-point: never beyond either end."""
        low_us, high_us = self._settings.pulse_window_us()
        exact_us = self._settings.pulse_us(float(pulled[0]))
        return {self._settings.channel: min(max(round(exact_us), low_us), high_us)}
