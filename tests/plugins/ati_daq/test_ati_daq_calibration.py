"""Calibration files: ATI's maths, all units, and files that are not what they should be."""

import struct

import numpy as np
import pytest
from cal_files import AXES, MAXIMA, ROWS, SCALES, cal_text
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.ati_daq import calibration
from labrun_plugins.ati_daq.reader import BlockParser


def test_a_load_is_the_sum_over_gauges_of_value_over_scale_times_voltage():
    read = calibration.parse(cal_text().encode())
    rng = np.random.default_rng(3)
    volts, bias = rng.uniform(-5, 5, (20, 6)), rng.uniform(-1, 1, 6)
    expected = [
        [sum(ROWS[i][j] / SCALES[i] * (v[j] - bias[j]) for j in range(6)) for i in range(6)] for v in volts
    ]
    np.testing.assert_allclose(read.load(volts, bias), expected, rtol=1e-12)
    np.testing.assert_allclose(read.maximum, MAXIMA)


def test_voltages_can_be_had_back_from_loads_matrix_and_bias():
    read = calibration.parse(cal_text().encode())
    volts, bias = np.random.default_rng(4).uniform(-5, 5, (20, 6)), np.linspace(-1, 1, 6)
    loads = read.load(volts, bias)
    np.testing.assert_allclose(np.linalg.solve(read.matrix, loads.T).T + bias, volts, atol=1e-10)


def test_without_scales_the_values_are_the_matrix():
    np.testing.assert_allclose(calibration.parse(cal_text(scale=False).encode()).matrix, ROWS)


@pytest.mark.parametrize(
    ("unit", "factor"), [("N-mm", 1e-3), ("Nmm", 1e-3), ("lbf-in", 0.1129848), ("kN-m", 1e3)]
)
def test_torques_and_their_range_come_in_newton_metres(unit, factor):
    plain, other = (calibration.parse(cal_text(torque_unit=u).encode()) for u in ("N-m", unit))
    np.testing.assert_allclose(other.matrix[3:], plain.matrix[3:] * factor, rtol=1e-6)
    np.testing.assert_allclose(other.maximum[3:], plain.maximum[3:] * factor, rtol=1e-6)
    np.testing.assert_allclose(other.matrix[:3], plain.matrix[:3])


def test_axes_may_stand_in_any_order():
    shuffled = calibration.parse(cal_text(axes=AXES[::-1]).encode())
    np.testing.assert_allclose(shuffled.matrix, calibration.parse(cal_text().encode()).matrix)


def test_what_the_file_tells_of_the_sensor_is_kept():
    message = calibration.parse(cal_text().encode()).attributes
    assert message["Serial"] == "FT98765"
    assert message["HWTempComp"] == "True"
    assert message["OutputRange"] == "20"
    assert "Dz 0.006" in message["BasicTransform"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (cal_text(axes=AXES[:5]), "axis Tz is missing"),
        (cal_text(axes=(*AXES, "Fx")), "axis 'fx' is given twice"),
        (cal_text(torque_unit="ozf-in"), "TorqueUnits = 'ozf-in' is not known"),
        (cal_text(root="Sensor"), "begins with <Sensor>"),
        (cal_text(gauges="8"), "only sensors with 6 gauges"),
        (cal_text().replace('max="60.0"', 'max="-1"'), "max of axis Fz is -1"),
        (cal_text().replace('scale="1.25"', 'scale="0"'), "scale of axis Fz is 0"),
        (cal_text().replace("24.2 ", "24.2 1 "), "axis Fz has 7 values"),
        (cal_text().replace("24.2 ", "nan "), "'nan' is not a number"),
        (cal_text().replace("24.2 ", "two "), "'two' is not a number"),
        (cal_text(extra="<Calibration/>"), "holds 2 calibrations"),
        (
            cal_text().replace(" ".join(map(str, ROWS[1])), " ".join(map(str, ROWS[0]))),
            "multiples of each other",
        ),
        ('<!DOCTYPE x [<!ENTITY a "b">]>' + cal_text()[38:], "declares a document type"),
        ("not xml", "not well-formed"),
        ("<FTSensor>" + " " * 300_000 + "</FTSensor>", "longer than"),
    ],
    ids=lambda part: part[:24].strip(),
)
def test_a_file_that_cannot_be_used_is_refused_and_told_why(text, message):
    with pytest.raises(calibration.CalibrationError, match=message):
        calibration.parse(text.encode())


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(calibration.CalibrationError, match="No such file"):
        calibration.read(tmp_path / "missing.cal")


@given(st.data())
def test_a_file_with_changed_bytes_is_a_usable_calibration_or_refused(data):
    text = bytearray(cal_text().encode())
    for _ in range(data.draw(st.integers(1, 8))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    try:
        read = calibration.parse(bytes(text))
    except calibration.CalibrationError:
        return
    assert np.isfinite(read.matrix).all()
    assert (read.maximum > 0).all()


def _block(first, values):
    return struct.pack(">4sIQ", b"LRV1", len(values), first) + np.asarray(values, ">f8").tobytes()


@given(st.lists(st.integers(1, 40), max_size=6), st.lists(st.integers(1, 300), max_size=60))
def test_blocks_come_out_whole_whatever_the_pieces_they_arrive_in(counts, cuts):
    rng = np.random.default_rng(5)
    sent, first = [], 0
    for count in counts:
        sent.append((first, rng.standard_normal((count, 6))))
        first += count
    wire = b"".join(_block(*block) for block in sent)
    parser, result, start = BlockParser(), [], 0
    for cut in [*cuts, len(wire)]:
        result += parser.feed(wire[start : start + cut])
        start += cut
    assert [block.first for block in result] == [first for first, _ in sent]
    for block, (_, values) in zip(result, sent, strict=True):
        np.testing.assert_array_equal(block.values, values)
    assert not parser.broken


@given(st.lists(st.binary(max_size=300), max_size=8))
def test_any_bytes_are_blocks_or_break_the_stream(pieces):
    parser = BlockParser()
    blocks = [block for piece in pieces for block in parser.feed(piece)]
    assert all(block.values.shape[1] == 6 for block in blocks)
    joined = b"".join(pieces)
    if len(joined) >= 16 and joined[:4] != b"LRV1":
        assert parser.broken
        assert blocks == []


def test_a_stream_that_lost_its_step_is_broken_for_ever():
    parser = BlockParser()
    whole = _block(0, np.zeros((3, 6)))
    assert len(parser.feed(whole)) == 1
    parser.feed(whole[:-8] + whole)
    assert parser.broken
    assert parser.feed(whole) == []
