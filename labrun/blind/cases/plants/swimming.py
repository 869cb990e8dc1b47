"""Benches in water or driven by position: a fin on a servo, a swimming body, a tethered one, a static relation."""

# ruff: noqa: ARG002 - the signatures are fixed, whatever of them a bench uses

import numpy as np

from ..plant import (
    At,
    Condition,
    FloatArray,
    Parameter,
    Plant,
    Programme,
    Signal,
    Site,
    Values,
    draw_between,
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
        spring = float(f"{inertia * (2 * np.pi * self.natural_hz) ** 2:.4g}")
        known = rng.random() < 0.5
        self.drag = rng.random() < 0.4
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
                Parameter(
                    "damping",
                    float(f"{rng.uniform(0.2, 0.7) * np.sqrt(spring * inertia):.4g}"),
                    "free",
                    "N m s/rad",
                ),
                Parameter("horn", 0.02, 0.0, "m"),
                *only_if(
                    self.drag, Parameter("drag", float(f"{0.4 * inertia:.4g}"), "free", "N m s^2/rad^2")
                ),
            ),
            equations={
                "angle": "rate",
                "rate": "(stiffness*(command - angle) - damping*rate"
                + (" - drag*abs(rate)*rate" if self.drag else "")
                + " + force.fin) / inertia",
            },
            sites=(
                Site(
                    "fin",
                    "joint",
                    "angle",
                    "rate",
                    effects=(
                        "coulomb-friction",
                        "stribeck-friction",
                        "presliding-friction",
                        "cubic-stiffness",
                        "asymmetric-friction",
                        "asymmetric-stiffness",
                        "viscoelastic-creep",
                        "hysteresis",
                        "end-stop",
                        "constant-force",
                        *only_if(not self.drag, "quadratic-drag"),
                        *only_if(known, "added-inertia"),
                    ),
                ),
            ),
            initial={"angle": "first" if rng.random() < 0.3 else 0.0, "rate": 0.0},
            input_effects={
                "command": ("delay", "lag", "saturation", "rate-limit", "dead-band", "gain-error", "bias")
            },
            output_effects={
                "angle": ("lag", "delay", "drift", "saturation", "gain-error", "bias", "cross-talk"),
                "horn_force": ("lag", "delay", "drift", "saturation", "gain-error", "bias", "cross-talk"),
            },
        )

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        pull = p["stiffness"] * (u[0] - x[0]) - p["damping"] * x[1] + force["fin"]
        if self.drag:
            pull = pull - p["drag"] * np.abs(x[1]) * x[1]
        return np.array([x[1], pull / p["inertia"]])

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        return np.array([x[0], p["stiffness"] * (u[0] - x[0]) / p["horn"]])

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        none = np.zeros_like(x[0])
        return At(x[0], x[1], none, none)

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        amplitude_deg = rng.uniform(15, 45)
        base = driven(rng, trials, time_base(rng), [np.deg2rad(amplitude_deg)], self.natural_hz * 0.45)
        for one in base.conditions:
            one["amplitude_deg"] = round(float(np.rad2deg(float(one.pop("amplitude")))), 3)
        return base


class Swimmer(Plant):
    """A body pushed along by a beating tail: free, with a speed sensor; or on a tether that measures the pull."""

    def __init__(self, rng: np.random.Generator) -> None:
        mass = near(rng, 2.5, 1.6)
        self.tether = rng.random() < 0.5
        self.quadratic = rng.random() < 0.6
        self.mass = mass
        self.natural_hz = rng.uniform(0.3, 0.7)
        spring = float(f"{mass * (2 * np.pi * self.natural_hz) ** 2:.4g}")
        drag = float(f"{mass * rng.uniform(2.0, 5.0):.4g}")
        linear = float(f"{mass * rng.uniform(0.3, 0.8):.4g}")
        # where drag is calibrated, it takes an error of its own; and with the thrust's share, an added mass
        drag_known = rng.random() < 0.6
        pull = " - tether*position" if self.tether else ""
        law = "drag*abs(speed)*speed" if self.quadratic else "damping*speed"
        exact = self.quadratic and drag_known
        effects = [
            "reynolds-dependent-drag",
            "wall-echo",
            "mean-current",
            *only_if(exact or not self.quadratic, "drag-error"),
            *only_if(exact or self.tether, "added-mass"),
        ]
        super().__init__(
            name="tethered-swimmer" if self.tether else "free-swimmer",
            states=("position", "speed"),
            inputs=(Signal("thrust", "N"),),
            outputs=(
                (
                    Signal("position", "m", equation="position"),
                    Signal("tension", "N", equation="tether*position"),
                )
                if self.tether
                else (Signal("speed_log", "m/s", equation="speed"),)
            ),
            parameters=(
                Parameter("mass", mass, 0.0, "kg"),
                Parameter("thrust_share", near(rng, 0.8, 1.15), "free", "1"),
                Parameter("drag", drag, 0.0 if drag_known else "free", "N s^2/m^2")
                if self.quadratic
                else Parameter("damping", linear, 0.04 if rng.random() < 0.3 else "free", "N s/m"),
                *only_if(self.tether, Parameter("tether", spring, 0.04, "N/m")),
            ),
            equations={
                "position": "speed",
                "speed": f"(thrust_share*thrust - {law}{pull} + force.hull) / mass",
            },
            returns=self.tether,
            sites=(Site("hull", "body", "position", "speed", effects=tuple(effects)),),
            initial={"position": 0.0, "speed": 0.0},
            input_effects={
                "thrust": ("lag", "delay", "saturation", "dead-band", "rate-limit")
                if self.tether
                else ("saturation", "dead-band")
            },
            output_effects=(
                {
                    "tension": ("lag", "delay", "drift", "bias", "saturation"),
                    "position": ("lag", "delay", "drift", "bias"),
                }
                if self.tether
                else {"speed_log": ("drift", "bias", "saturation")}
            ),
        )

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        pull = p["thrust_share"] * u[0] + force["hull"]
        pull = pull - (p["drag"] * np.abs(x[1]) * x[1] if self.quadratic else p["damping"] * x[1])
        if self.tether:
            pull = pull - p["tether"] * x[0]
        return np.array([x[1], pull / p["mass"]])

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        return np.array([x[0], p["tether"] * x[0]]) if self.tether else x[1:].copy()

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        none = np.zeros_like(x[0])
        return At(x[0], x[1], none, none)

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
        return Programme(time_s, [conditions[one] for one in order], round_inputs(inputs[:, :, order]))


class StaticFin(Plant):
    """No states: the torque a fin held in a stream needs, against its commanded angle, its speed and the stream."""

    def __init__(self, rng: np.random.Generator) -> None:
        stiffness = near(rng, 0.3, 1.6)
        self.side = rng.random() < 0.6
        self.static_torque = stiffness * 0.3
        super().__init__(
            name="static-fin",
            inputs=(Signal("angle", "rad"), Signal("rate", "rad/s")),
            outputs=(
                Signal(
                    "torque",
                    "N m",
                    equation="stiffness*angle + damping*rate + lift*stream_m_s^2*sin(2*angle) - force.root",
                ),
                *only_if(
                    self.side, Signal("side_force", "N", equation="slope*sin(angle)*(0.2 + stream_m_s^2)")
                ),
            ),
            parameters=(
                Parameter("stiffness", stiffness, "free", "N m/rad"),
                Parameter("damping", near(rng, stiffness * 0.05, 1.5), "free", "N m s/rad"),
                Parameter("lift", near(rng, stiffness * 0.5, 1.4), 0.05, "N m s^2/m^2"),
                *only_if(self.side, Parameter("slope", near(rng, 2.0), "free", "N")),
            ),
            sites=(
                Site(
                    "root",
                    "joint",
                    "angle",
                    "rate",
                    effects=(
                        "coulomb-friction",
                        "stribeck-friction",
                        "presliding-friction",
                        "cubic-stiffness",
                        "asymmetric-friction",
                        "asymmetric-stiffness",
                        "hysteresis",
                        "viscoelastic-creep",
                        "quadratic-drag",
                        "end-stop",
                        "constant-force",
                    ),
                ),
            ),
            conditions=("stream_m_s",),
            input_effects={"angle": only_if(self.side, "delay", "lag", "saturation")},
            output_effects={
                "torque": (
                    "lag",
                    "delay",
                    "drift",
                    "bias",
                    "saturation",
                    *only_if(self.side, "cross-talk"),
                )
            }
            | (
                {"side_force": ("lag", "delay", "drift", "bias", "saturation", "cross-talk")}
                if self.side
                else {}
            ),
        )

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        return np.zeros((0, u.shape[1]))

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        torque = p["stiffness"] * u[0] + p["damping"] * u[1] - force["root"]
        torque = torque + p["lift"] * p["stream_m_s"] ** 2 * np.sin(2 * u[0])
        if not self.side:
            return np.asarray(torque[None, :])
        return np.array([torque, p["slope"] * np.sin(u[0]) * (0.2 + p["stream_m_s"] ** 2)])

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        none = np.zeros_like(u[0])
        return At(u[0], u[1], none, none)

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        time_s = time_base(rng)
        base = driven(rng, trials, time_s, [np.deg2rad(rng.uniform(20, 45))], 0.7, _SMOOTH)
        angle = base.inputs[0]
        rate = np.gradient(angle, time_s, axis=0)
        base.inputs = round_inputs(np.stack([angle, rate]))
        for index, one in enumerate(base.conditions):
            one["stream_m_s"] = (0.0, 0.25, 0.5)[index % 3]
            one["amplitude_deg"] = round(float(np.rad2deg(float(one.pop("amplitude")))), 3)
        return base
