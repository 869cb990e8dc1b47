"""Frames as the emulator sends them: a plain one, and one with something in every section."""

from labrun_plugins.optitrack import emulator_wire as wire

LAYOUTS = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]
BODY = wire.RigidBody(1, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0), 0.0005, 1)
PLAIN = wire.Content(42, bodies=[BODY], timestamp=12.5, ticks=(1000, 1100, 1200), precision=(3, 7))
FULL = wire.Content(
    -7,
    bodies=[
        wire.RigidBody(3, (1, 2, 3), (0.5, -0.5, 0.5, 0.5), 0.001, 1),
        wire.RigidBody(9, (0, 0, 0), (0, 0, 0, 1), 0, 0),
    ],
    marker_sets=[("all", [(1, 2, 3), (4, 5, 6)]), ("", [])],
    others=[(7, 8, 9)],
    skeletons=[(4, [BODY, BODY]), (5, [])],
    assets=[(6, [BODY], [wire.LabelledMarker(1, (0, 0, 0))])],
    markers=[wire.LabelledMarker(3 << 16 | 2, (0.5, 0.25, 0.125)), wire.LabelledMarker(77, (0, 0, 0), params=0x11)],
    plates=[wire.Analog(1, [(0.5, 1.5), ()])],
    devices=[wire.Analog(2, [(2.5,)])],
    timestamp=99.25, ticks=(2**63 + 5, 2**63 + 6, 2**64 - 1), precision=(8, 9), params=1,
)  # fmt: skip
