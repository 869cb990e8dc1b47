"""Controllers of a third party that answer for a whole loop."""


class Mixer:
    """Sets both variables to the first reference; counts its steps, and records what it was shown."""

    several = True
    channel_settings = ("watch",)

    def __init__(self, settings, context):
        self.channels = (settings["watch"],)
        self.steps = 0
        self.seen = 0.0

    @staticmethod
    def records(settings):
        return {"steps": "1", "seen": "rad"}

    def update(self, step):
        self.steps += 1
        self.seen = step.channels[self.channels[0]]
        return step.reference[0], step.reference[0]

    def applied(self, drives):
        assert len(drives) == 2

    def recorded(self):
        return {"steps": float(self.steps), "seen": self.seen}
