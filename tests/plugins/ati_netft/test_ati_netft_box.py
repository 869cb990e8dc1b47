"""What the box says about itself: units in every spelling, and nothing that could hurt."""

import contextlib
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.ati_netft import codec, network, strict_xml, units

GOOD = {
    "prodname": "Net F/T", "setserial": "FT12345", "cfgcpf": "1000000", "cfgcpt": "1000", "scfgfu": "N",
    "scfgtu": "N-mm", "comrdtrate": "7000", "comrdtbsiz": "40", "runstat": "0x00000000",
}  # fmt: skip


def xml(**changes):
    values = {**GOOD, **changes}
    body = "".join(f"<{k}>{v}</{k}>" for k, v in values.items() if v is not None)
    return f'<?xml version="1.0" encoding="ISO-8859-1"?><netft><inner>{body}</inner></netft>'.encode(
        "latin-1"
    )


def test_counts_become_newtons_and_newton_metres_with_torques_in_n_mm():
    info = network.parse(xml())
    record = codec.decode(
        bytes.fromhex(
            "00000001 00001267 00000000 000F4240 FFE17B80 003567E0 000003E8 FFFFFE0C 000000FA".replace(
                " ", ""
            )
        )
    )
    assert record is not None
    np.testing.assert_allclose(
        info.to_si(record["counts"])[0], [1.0, -2.0, 3.5, 1e-3, -0.5e-3, 0.25e-3], rtol=1e-12
    )
    assert (info.serial, info.product, info.rate_hz, info.buffer_size) == ("FT12345", "Net F/T", 7000.0, 40)


@pytest.mark.parametrize(
    ("text", "newton_metres"),
    [
        ("N-m", 1.0), ("Nm", 1.0), ("N m", 1.0), ("N*m", 1.0), ("Newton-meters", 1.0),
        ("N-mm", 1e-3), ("Nmm", 1e-3), ("N·mm", 1e-3), ("kN-m", 1e3), ("kgf-cm", 0.0980665),
        ("lbf-in", 0.112984829), ("in-lbf", 0.112984829), ("lbf-ft", 1.355817948),
    ],
)  # fmt: skip
def test_every_spelling_of_a_torque_unit_is_known(text, newton_metres):
    assert units.newton_metres_per(text) == pytest.approx(newton_metres, rel=1e-8)
    info = network.parse(xml(scfgtu=text))
    assert info.si_per_count()[5] == pytest.approx(newton_metres / 1000, rel=1e-8)


@pytest.mark.parametrize(
    ("text", "newtons"), [("N", 1.0), ("kN", 1e3), ("lbf", 4.44822162), ("kgf", 9.80665), ("gf", 9.80665e-3)]
)
def test_every_unit_of_force_is_known(text, newtons):
    assert network.parse(xml(scfgfu=text)).si_per_count()[0] == pytest.approx(newtons / 1e6, rel=1e-8)


def test_the_numbered_units_of_the_tcp_port_are_those_of_the_manual():
    assert [units.newtons_per(units.unit_of_code(units.FORCE_CODES, i)) for i in (2, 4)] == [1.0, 1e3]
    assert [units.newton_metres_per(units.unit_of_code(units.TORQUE_CODES, i)) for i in (3, 4)] == [1.0, 1e-3]
    assert units.unit_of_code(units.TORQUE_CODES, 0) == units.unit_of_code(units.FORCE_CODES, 99) == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cfgcpf": None}, "does not give cfgcpf"),
        ({"cfgcpt": "0"}, "cfgcpt = 0 counts per unit is not above 0"),
        ({"cfgcpt": "nan"}, "cfgcpt = 'nan' is not a number"),
        ({"scfgtu": "stone-furlong"}, "'stone-furlong' is not a known unit of torque"),
        ({"scfgfu": "dyn"}, "'dyn' is not a known unit of force"),
        ({"comrdtrate": "8000"}, "comrdtrate = 8000 is outside 1 to 7000"),
        ({"prodname": "x" * 200}, "prodname of netftapi2.xml is not a text"),
        ({"setserial": "a<cfgcpf>5</cfgcpf>"}, "gives cfgcpf 2 times"),
    ],
)
def test_a_set_up_that_cannot_be_used_is_refused_with_its_name(changes, message):
    with pytest.raises(network.BoxInfoError, match=message):
        network.parse(xml(**changes))


BOMB = (
    b'<!DOCTYPE l [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    b"<netft><cfgcpf>&b;</cfgcpf></netft>"
)


@pytest.mark.parametrize(
    "data",
    [
        BOMB,
        b'<!DOCTYPE x SYSTEM "file:///etc/passwd"><netft/>',
        b"<?xml-stylesheet href='x'?><netft/>",
        b"<netft>" + b" " * 70_000 + b"</netft>",
        b"<netft>", b"", b"\x00\xff", b"<html><body>404",
    ],
    ids=lambda data: repr(data[:24]),
)  # fmt: skip
def test_xml_that_is_not_plain_is_refused(data):
    with pytest.raises(strict_xml.XmlRefusedError):
        strict_xml.parse(data, 65_536)


@given(st.one_of(st.binary(max_size=400), st.text(max_size=200).map(lambda t: f"<a>{t}</a>".encode())))
def test_any_bytes_are_xml_or_refused(data):
    with contextlib.suppress(strict_xml.XmlRefusedError):
        assert isinstance(strict_xml.parse(data, 300), Element)


@given(st.data())
def test_a_page_with_changed_bytes_is_a_usable_set_up_or_refused(data):
    page = bytearray(xml())
    for _ in range(data.draw(st.integers(1, 6))):
        page[data.draw(st.integers(0, len(page) - 1))] = data.draw(st.integers(0, 255))
    try:
        info = network.parse(bytes(page))
    except network.BoxInfoError:
        return
    assert np.isfinite(info.si_per_count()).all()
    assert (info.si_per_count() > 0).all()


@pytest.mark.parametrize(
    ("wanted", "rate"), [(500, 500.0), (501, 500.0), (7000, 7000.0), (6000, 7000.0), (999, 1000.0)]
)
def test_the_rate_is_the_nearest_seven_thousandth(wanted, rate):
    assert network.box_rate(wanted) == pytest.approx(rate)
