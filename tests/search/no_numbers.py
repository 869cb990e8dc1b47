"""An objective of a third party that never has a value, or none for the trials that confirm."""


class Nothing:
    """Not a number, from the n-th trial on."""

    def __init__(self, channel, settings):
        self.first = settings.get("first", 0)
        self.count = 0

    def unit(self, channel_unit):
        return channel_unit

    def __call__(self, signals):
        self.count += 1
        return float("nan") if self.count > self.first else 1.0
