"""Objectives of a third party on a bad day."""


class _Bad:
    def __init__(self, channel, settings):
        pass

    def unit(self, channel_unit):
        return channel_unit


class Raising(_Bad):
    """Raises what nobody expects."""

    def __call__(self, signals):
        raise RuntimeError("the reference file is gone")


class Forgetful(_Bad):
    """Returns nothing."""

    def __call__(self, signals):
        return None
