"""An objective that has no value."""


class Nothing:
    """Always not a number."""

    def __init__(self, channel, settings):
        pass

    def unit(self, channel_unit):
        return channel_unit

    def __call__(self, signals):
        return float("nan")
