"""A constant pose."""

from labrun.gaits.release import ReleaseGait


class HoldGait(ReleaseGait):
    """Hold each joint at its ``angle_deg`` while samples are taken: the drag of a pose, a body towed."""

    @classmethod
    def _name(cls) -> str:
        return "hold"
