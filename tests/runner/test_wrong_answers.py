"""A driver that returns what it must not is named with its method."""

import os
import signal
import threading

import pytest

from labrun.errors import DeviceError
from labrun.interrupts import Interrupted

ONE = [{"a": 10, "f": 1.0}]


@pytest.mark.parametrize(
    ("key", "answer", "message"),
    [
        ("read_answers", "none", r"its read\(\) returned None; expected Samples"),
        ("read_answers", "list", r"its read\(\) returned a list; expected Samples"),
        ("read_answers", "doubled", r"its read\(\) returned every sample twice"),
        ("read_answers", "again", r"its read\(\) returned samples that it had returned before"),
        ("health_answers", "none", r"its health\(\) returned None; expected Health"),
        ("health_answers", "list", r"its health\(\) returned a list; expected Health"),
    ],
)
def test_a_wrong_answer_names_device_and_method(lab, key, answer, message):
    lab = lab(**{f"rig__devices__cell__{key}": answer})
    with pytest.raises(DeviceError, match=f"device cell: {message}"):
        lab.session.measure(ONE)


def test_one_signal_ends_a_dry_run_whose_sensor_hangs(lab):
    lab = lab(rig__devices__cell__hang_after_s=5.0)
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM))
    timer.start()
    with pytest.raises(Interrupted, match="interrupted by SIGTERM"):
        lab.session.measure(ONE)
