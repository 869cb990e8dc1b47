"""What an experiment file says about a solver."""

from typing import ClassVar

from pydantic import Field, PositiveFloat

from labrun.devices import DeviceSettings


class CommandSettings(DeviceSettings):
    """Keys of a command.

    Attributes
    ----------
    run
        The program and its arguments, one text each. ``{name}`` stands for a value of the condition, ``{output}`` for
        the CSV file that the program has to write.
    channels
        Columns of that file that are read, with their units.
    time
        Its column of time, s; without it rows follow each other at `rate_hz`.
    rate_hz
        Rows a second, as the trial plays them.
    timeout_s
        How long the program may take.
    keep
        Folder for what was computed: a condition is computed once, also in later runs.
    """

    example: ClassVar[str] = (
        'run = ["python", "solve.py", "--angle", "{angle}", "--output", "{output}"]\n'
        'channels = { moment = "N m" }        # columns of the CSV file, with their units\n'
        "timeout_s = 3600"
    )

    run: list[str] = Field(min_length=1)
    channels: dict[str, str] = Field(min_length=1)
    time: str | None = None
    rate_hz: PositiveFloat = 100.0
    timeout_s: PositiveFloat = 3600.0
    keep: str = "solver"
