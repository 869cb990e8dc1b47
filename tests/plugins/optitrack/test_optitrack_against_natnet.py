"""The emulator's bytes as another project's parser reads them."""

import pytest

natnet_frame = pytest.importorskip("natnet.data_frame")
natnet_model = pytest.importorskip("natnet.data_descriptions")

from labrun_plugins.optitrack import emulator_wire as wire  # noqa: E402
from labrun_plugins.optitrack.frame import decode_frame  # noqa: E402
from natnet.packet_buffer import PacketBuffer  # noqa: E402  only where it is installed
from natnet.server_info import ServerInfo  # noqa: E402
from natnet.version import Version  # noqa: E402
from optitrack_frames import FULL, LAYOUTS  # noqa: E402


@pytest.mark.parametrize("version", LAYOUTS)
def test_driver_and_natnet_read_the_same_frame(version):
    """But for the params from 4.0 on, where natnet 0.3.0 reads the precision stamps in their place."""
    payload = wire.frame(FULL, version)[4:]
    theirs = natnet_frame.DataFrame.read_from_buffer(PacketBuffer(payload), Version(*version))
    ours = decode_frame(payload, version, with_markers=True)
    assert ours is not None
    assert theirs.prefix.frame_number % 2**32 == ours.number % 2**32
    assert [(b.id_num, (*b.pos, *b.rot), b.tracking_valid) for b in theirs.rigid_bodies] == [
        (b.id, b.pose, b.measured) for b in ours.bodies
    ]
    assert [(m.id_num, m.pos, m.param) for m in theirs.labeled_markers] == [
        (m.id, m.position, m.params) for m in ours.markers
    ]
    assert theirs.suffix.stamp_camera_mid_exposure == ours.exposed
    assert theirs.suffix.stamp_transmit == ours.sent
    assert theirs.suffix.timestamp == ours.timestamp_s
    if version < (4, 0):
        assert theirs.suffix.param == ours.params
    assert len(theirs.marker_sets) == len(FULL.marker_sets)
    assert len(theirs.skeletons) == len(FULL.skeletons)
    assert [plate.channel_arrays for plate in theirs.force_plates] == [((0.5, 1.5), ())]


@pytest.mark.parametrize("version", LAYOUTS)
def test_natnet_reads_the_emulators_model(version):
    bodies = [wire.BodyDescription("arm", 11, [(0, 0, 0), (1, 2, 3)]), wire.BodyDescription("wand", 1)]
    payload = wire.model(bodies, version, rich=False)[4:]
    theirs = natnet_model.DataDescriptions.read_from_buffer(PacketBuffer(payload), Version(*version))
    assert [(b.name, b.id_num, len(b.markers)) for b in theirs.rigid_bodies] == [
        ("arm", 11, 2),
        ("wand", 1, 0),
    ]


def test_natnet_reads_the_emulators_server_info():
    payload = wire.server_info((3, 1, 0, 0), (4, 1, 0, 0), 10_000_000, 1511, False, "239.255.42.99")[4:]
    theirs = ServerInfo.read_from_buffer(PacketBuffer(payload), Version(4, 1))
    assert theirs.application_name == "Motive"
    assert theirs.nat_net_protocol_version == Version(4, 1, 0, 0)
