"""What every device behind a board with `labservo` does alike: connect, stop, and say how it is."""

from typing import Any, ClassVar

from labrun.devices import Health, Identity, Remark
from labrun_plugins.arduino_servo.examination import examine
from labrun_plugins.arduino_servo.servo_board import ServoBoard
from labrun_plugins.arduino_servo.settings import BoardSettings
from labrun_plugins.labline.handshake import probe, stop_from_scratch


class BoardDevice:
    """Servos behind a board; what they move is for the subclass to say.

    Parameters
    ----------
    name
        The device's name.
    settings
        Of the board.
    board
        The driver's end of it.
    """

    kind: ClassVar[str]
    """What its firmware says it is."""

    def __init__(self, name: str, settings: BoardSettings, board: ServoBoard) -> None:
        self.name = name
        self._board = board
        self._board_settings = settings

    def open(self) -> None:
        """Connect; no servo gets a pulse yet.

        Raises
        ------
        DeviceError
            No port, no answer, other firmware, or fewer channels than are needed.
        """
        self._board.open()

    def health(self) -> Health:
        """Ask the board for its state; notes lines that were damaged or stayed unanswered."""
        return self._board.health()

    def safe_stop(self) -> None:
        """Have the board stop where it is, asking once more if it does not answer; no set-point follows."""
        self._board.safe_stop()

    def close(self) -> None:
        """Stop, turn the watchdog off so that it has nothing to tell, and disconnect. Servos go on holding."""
        self._board.close()

    def examine(self) -> list[Remark]:
        """Look at firmware, channels, rate and watchdog, for `labrun doctor --hardware`."""
        return examine(self.name, self._board, self._board_settings)

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Connect from scratch and stop; raises DeviceError if the board does not answer."""
        stop_from_scratch(name, settings.port)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Tell whether a board with this firmware is at a port; takes up to 3.5 s, as boards restart when opened."""
        return probe(port, cls.kind)
