import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.devices import SampleBuffer


def test_samples_come_out_in_the_order_they_went_in_whether_alone_or_in_blocks():
    buffer = SampleBuffer(2)
    buffer.put(1.0, 10.0, [1, 2])
    buffer.put([2.0, 3.0], [11.0, 12.0], [[3, 4], [5, 6]], lost=1, saturated=2)
    samples = buffer.take()
    assert samples.device_time_s.tolist() == [1, 2, 3]
    assert samples.host_time_s.tolist() == [10, 11, 12]
    assert samples.values.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert (samples.lost, samples.saturated) == (1, 2)


def test_what_was_taken_is_gone_and_losses_alone_are_told_too():
    buffer = SampleBuffer(3)
    buffer.put(0.0, 0.0, [1, 2, 3])
    buffer.take()
    buffer.count_lost(4)
    samples = buffer.take()
    assert len(samples) == 0
    assert samples.values.shape == (0, 3)
    assert samples.lost == 4


@pytest.mark.parametrize("values", [[1.0], [[1.0, 2.0], [3.0, 4.0]], [1.0, 2.0, 3.0]])
def test_shapes_that_do_not_belong_together_are_refused_before_they_spoil_a_recording(values):
    buffer = SampleBuffer(2)
    with pytest.raises(ValueError, match="do not make samples of 2 channels"):
        buffer.put(0.0, 0.0, values)
    assert len(buffer.take()) == 0


@given(st.lists(st.integers(1, 5), max_size=20), st.lists(st.booleans(), max_size=20))
def test_no_sample_is_lost_or_doubled_however_puts_and_takes_alternate(sizes, takes):
    buffer, seen, number = SampleBuffer(1), [], 0
    for size, take in zip(sizes, [*takes, *[False] * len(sizes)], strict=False):
        rows = np.arange(number, number + size, dtype=float)
        buffer.put(rows, rows, rows[:, None])
        number += size
        if take:
            seen += buffer.take().values[:, 0].tolist()
    seen += buffer.take().values[:, 0].tolist()
    assert seen == list(range(number))


def test_a_thread_that_puts_while_another_takes_loses_nothing():
    buffer, seen = SampleBuffer(1), []
    total = 5000

    def put():
        for number in range(total):
            buffer.put(number, number, [number])

    thread = threading.Thread(target=put)
    thread.start()
    while thread.is_alive():
        seen += buffer.take().values[:, 0].tolist()
    seen += buffer.take().values[:, 0].tolist()
    assert seen == list(range(total))
