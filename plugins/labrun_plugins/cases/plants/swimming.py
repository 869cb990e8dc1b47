"""Benches in water or driven by position: a fin on a servo, a swimming body, a tethered one, a static relation."""

import numpy as np

from ..plant import (
    DRIVEN,
    READ,
    YIELDING,
    Condition,
    Parameter,
    Plant,
    Programme,
    Signal,
    Site,
    damping_of,
    draw_between,
    four_digits,
    near,
    only_if,
)
from .programmes import driven, round_inputs, time_base

_SMOOTH = ("sine", "chirp", "multisine", "triangle")
"""Signals whose speed can be recorded."""


class ServoFin(Plant):
    """A compliant fin whose root follows a commanded angle; a load cell in the horn measures the root's force."""

    def __init__(self, rng: np.random.Generator) -> None:
        inertia, self.natural_hz = near(rng, 8e-4, 1.6), rng.uniform(2.0, 4.5)
        spring = four_digits(inertia * (2 * np.pi * self.natural_hz) ** 2)
        known, drag = rng.random() < 0.5, rng.random() < 0.4
        resisted = "damping*rate" + (" - drag*abs(rate)*rate" if drag else "")
        hidden = (
            *YIELDING, "constant-force", *only_if(not drag, "quadratic-drag"), *only_if(known, "added-inertia"),
        )  # fmt: skip
        seen = (*READ, "gain-error", "bias", "cross-talk")
        super().__init__(
            name="servo-fin",
            states=("angle", "rate"),
            inputs=(Signal("command", "rad", draw_between(rng)),),
            outputs=(
                Signal("angle", "rad", equation="angle"),
                Signal("horn_force", "N", equation="stiffness*(command - angle) / horn"),
            ),
            parameters=(
                Parameter("inertia", inertia, 0.0 if known else 0.05, "kg m^2"),
                Parameter("stiffness", spring, "free", "N m/rad"),
                damping_of(rng, "damping", (0.2, 0.7), spring * inertia),
                Parameter("horn", 0.02, 0.0, "m"),
                *only_if(drag, Parameter("drag", four_digits(0.4 * inertia), "free", "N m s^2/rad^2")),
            ),
            equations={
                "angle": "rate",
                "rate": f"(stiffness*(command - angle) - {resisted} + force.fin) / inertia",
            },
            sites=(Site("fin", "joint", "angle", "rate", effects=hidden),),
            initial={"angle": "first" if rng.random() < 0.3 else 0.0, "rate": 0.0},
            input_effects={"command": (*DRIVEN, "gain-error", "bias")},
            output_effects={"angle": seen, "horn_force": seen},
        )

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        amplitude_deg = rng.uniform(15, 45)
        base = driven(rng, trials, time_base(rng), [np.deg2rad(amplitude_deg)], self.natural_hz * 0.45)
        for condition in base.conditions:
            condition["amplitude_deg"] = round(float(np.rad2deg(float(condition.pop("amplitude")))), 3)
        return base


class Swimmer(Plant):
    """A body pushed along by a beating tail: free, with a speed sensor; or on a tether that measures the pull."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.mass = mass = near(rng, 2.5, 1.6)
        self.tether, quadratic = rng.random() < 0.5, rng.random() < 0.6
        self.natural_hz = rng.uniform(0.3, 0.7)
        spring = four_digits(mass * (2 * np.pi * self.natural_hz) ** 2)
        drag = four_digits(mass * rng.uniform(2.0, 5.0))
        linear = four_digits(mass * rng.uniform(0.3, 0.8))
        # where drag is calibrated, it takes an error of its own; and with the thrust's share, an added mass
        drag_known = rng.random() < 0.6
        pull = " - tether*position" if self.tether else ""
        law = "drag*abs(speed)*speed" if quadratic else "damping*speed"
        exact = quadratic and drag_known
        hidden = (
            "reynolds-dependent-drag", "wall-echo", "mean-current",
            *only_if(exact or not quadratic, "drag-error"), *only_if(exact or self.tether, "added-mass"),
        )  # fmt: skip
        if self.tether:
            outputs: tuple[Signal, ...] = (
                Signal("position", "m", equation="position"),
                Signal("tension", "N", equation="tether*position"),
            )
            pushed: tuple[str, ...] = ("lag", "delay", "saturation", "dead-band", "rate-limit")
            seen = {
                "tension": ("lag", "delay", "drift", "bias", "saturation"),
                "position": ("lag", "delay", "drift", "bias"),
            }
        else:
            outputs = (Signal("speed_log", "m/s", equation="speed"),)
            pushed = ("saturation", "dead-band")
            seen = {"speed_log": ("drift", "bias", "saturation")}
        super().__init__(
            name="tethered-swimmer" if self.tether else "free-swimmer",
            states=("position", "speed"),
            inputs=(Signal("thrust", "N"),),
            outputs=outputs,
            parameters=(
                Parameter("mass", mass, 0.0, "kg"),
                Parameter("thrust_share", near(rng, 0.8, 1.15), "free", "1"),
                Parameter("drag", drag, 0.0 if drag_known else "free", "N s^2/m^2")
                if quadratic
                else Parameter("damping", linear, 0.04 if rng.random() < 0.3 else "free", "N s/m"),
                *only_if(self.tether, Parameter("tether", spring, 0.04, "N/m")),
            ),
            equations={
                "position": "speed",
                "speed": f"(thrust_share*thrust - {law}{pull} + force.hull) / mass",
            },
            returns=self.tether,
            sites=(Site("hull", "body", "position", "speed", effects=hidden),),
            initial={"position": 0.0, "speed": 0.0},
            input_effects={"thrust": pushed},
            output_effects=seen,
        )

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        time_s = time_base(rng)
        conditions: list[Condition] = []
        inputs = np.zeros((1, len(time_s), trials))
        for index in range(trials):
            beat_hz = round(float(np.linspace(0.35, 1.3, trials)[index]), 3)
            amplitude_deg = float((15.0, 24.0, 33.0)[index % 3] + (index // 3 % 2) * 4.0)
            # a tail pushes twice a beat; some programmes stop half way, so that the body coasts
            coast = index % 2 == 1
            push = self.mass * 0.9 * np.sin(np.deg2rad(amplitude_deg)) * (0.6 + 0.5 * beat_hz)
            beating = push * np.sin(2 * np.pi * beat_hz * time_s) ** 2 * np.minimum(time_s / 0.5, 1.0)
            if coast:
                beating = np.where(time_s > 0.6 * time_s[-1], 0.0, beating)
            if self.tether and index % 3 == 2:
                beating = beating * np.sign(np.sin(np.pi * beat_hz * time_s / 2))
            inputs[0, :, index] = beating
            conditions.append({"beat_hz": beat_hz, "amplitude_deg": amplitude_deg, "coast": float(coast)})
        order = rng.permutation(trials)
        return Programme(time_s, [conditions[trial] for trial in order], round_inputs(inputs[:, :, order]))


class StaticFin(Plant):
    """No states: the torque a fin held in a stream needs, against its commanded angle, its speed and the stream."""

    def __init__(self, rng: np.random.Generator) -> None:
        stiffness = near(rng, 0.3, 1.6)
        side = rng.random() < 0.6
        law = "stiffness*angle + damping*rate + lift*stream_m_s^2*sin(2*angle) - force.root"
        hidden = (
            "coulomb-friction", "stribeck-friction", "presliding-friction", "cubic-stiffness",
            "asymmetric-friction", "asymmetric-stiffness", "hysteresis", "viscoelastic-creep", "quadratic-drag",
            "end-stop", "constant-force",
        )  # fmt: skip
        seen = ("lag", "delay", "drift", "bias", "saturation")
        super().__init__(
            name="static-fin",
            inputs=(Signal("angle", "rad"), Signal("rate", "rad/s")),
            outputs=(
                Signal("torque", "N m", equation=law),
                *only_if(side, Signal("side_force", "N", equation="slope*sin(angle)*(0.2 + stream_m_s^2)")),
            ),
            parameters=(
                Parameter("stiffness", stiffness, "free", "N m/rad"),
                Parameter("damping", near(rng, stiffness * 0.05, 1.5), "free", "N m s/rad"),
                Parameter("lift", near(rng, stiffness * 0.5, 1.4), 0.05, "N m s^2/m^2"),
                *only_if(side, Parameter("slope", near(rng, 2.0), "free", "N")),
            ),
            sites=(Site("root", "joint", "angle", "rate", effects=hidden),),
            conditions=("stream_m_s",),
            input_effects={"angle": only_if(side, "delay", "lag", "saturation")},
            output_effects={"torque": (*seen, *only_if(side, "cross-talk"))}
            | ({"side_force": (*seen, "cross-talk")} if side else {}),
        )

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        time_s = time_base(rng)
        base = driven(rng, trials, time_s, [np.deg2rad(rng.uniform(20, 45))], 0.7, _SMOOTH)
        angle = base.inputs[0]
        rate = np.gradient(angle, time_s, axis=0)
        base.inputs = round_inputs(np.stack([angle, rate]))
        for index, condition in enumerate(base.conditions):
            condition["stream_m_s"] = (0.0, 0.25, 0.5)[index % 3]
            condition["amplitude_deg"] = round(float(np.rad2deg(float(condition.pop("amplitude")))), 3)
        return base
