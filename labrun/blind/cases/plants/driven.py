"""Driven mechanisms: a hinge with a torque, an arm with a payload, a linear stage."""

# ruff: noqa: ARG002 - the signatures are fixed, whatever of them a bench uses

import numpy as np

from ..plant import (
    At,
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
from .programmes import driven, time_base

_G = 9.80665
_JOINT = (
    "coulomb-friction",
    "stribeck-friction",
    "presliding-friction",
    "cubic-stiffness",
    "asymmetric-friction",
    "asymmetric-stiffness",
    "viscoelastic-creep",
    "hysteresis",
    "end-stop",
    "quadratic-drag",
)
_INPUT = ("delay", "lag", "saturation", "rate-limit", "dead-band")
_OUTPUT = ("lag", "delay", "drift", "saturation")


class HingeDrive(Plant):
    """A pendulum on a spring hinge, driven by a torque; some with a cell that measures the hinge's reaction."""

    def __init__(self, rng: np.random.Generator) -> None:
        inertia, natural_hz = near(rng, 1.5e-3, 2.0), rng.uniform(0.8, 2.5)
        total = inertia * (2 * np.pi * natural_hz) ** 2
        sprung = rng.random() < 0.5
        cell = rng.random() < 0.6
        known = rng.random() < 0.5
        gravity = float(f"{total * rng.uniform(0.3, 0.6):.4g}")
        damping = rng.random() < 0.8
        self.damped = damping
        self.cell = cell
        spring = float(f"{total - gravity:.4g}")
        self.peak = total
        super().__init__(
            name="hinge-drive",
            states=("angle", "rate"),
            inputs=(Signal("torque", "N m", draw_between(rng)),),
            outputs=(
                Signal("angle", "rad", equation="angle"),
                *only_if(
                    cell,
                    Signal(
                        "reaction",
                        "N m",
                        equation=f"stiffness*angle{' + damping*rate' if damping else ''} - force.hinge",
                    ),
                ),
            ),
            parameters=(
                Parameter("inertia", inertia, 0.0 if known else 0.03, "kg m^2"),
                Parameter("gravity_torque", gravity, 0.03, "N m"),
                Parameter("stiffness", spring, "free", "N m/rad"),
                *only_if(
                    damping,
                    Parameter(
                        "damping",
                        float(f"{rng.uniform(0.06, 0.3) * np.sqrt(total * inertia):.4g}"),
                        "free",
                        "N m s/rad",
                    ),
                ),
            ),
            equations={
                "angle": "rate",
                "rate": "(torque + force.hinge - stiffness*angle"
                + (" - damping*rate" if damping else "")
                + " - gravity_torque*sin(angle)) / inertia",
            },
            sites=(
                Site(
                    "hinge",
                    "joint",
                    "angle",
                    "rate",
                    "stiffness" if sprung else "",
                    "gravity_torque*cos(angle)",
                    effects=(
                        *_JOINT,
                        "load-dependent-friction",
                        *(("backlash",) if sprung else ("constant-force",)),
                        *only_if(known, "added-inertia"),
                        *only_if(not damping, "viscous-damping"),
                    ),
                ),
            ),
            initial={"angle": 0.0, "rate": 0.0},
            input_effects={
                "torque": (
                    *(_INPUT if cell else ("saturation", "rate-limit", "dead-band")),
                    *only_if(not sprung, "bias"),
                    *only_if(known and cell, "gain-error"),
                )
            },
            output_effects={"angle": (*(_OUTPUT if cell else ("drift", "saturation")), "bias")}
            | (
                {"reaction": ("lag", "delay", "drift", "saturation", "bias", "gain-error", "cross-talk")}
                if cell
                else {}
            ),
        )
        self.natural_hz = natural_hz

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        pull = u[0] + force["hinge"] - p["stiffness"] * x[0] - p["gravity_torque"] * np.sin(x[0])
        if self.damped:
            pull = pull - p["damping"] * x[1]
        return np.array([x[1], pull / p["inertia"]])

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        if not self.cell:
            return x[:1].copy()
        reaction = p["stiffness"] * x[0] - force["hinge"]
        if self.damped:
            reaction = reaction + p["damping"] * x[1]
        return np.array([x[0], reaction])

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        return At(x[0], x[1], p["gravity_torque"] * np.cos(x[0]), p["stiffness"])

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.peak * rng.uniform(0.15, 0.35)], self.natural_hz)


class PayloadArm(Plant):
    """An arm that lifts different payloads against gravity, held by a proportional loop on the commanded angle."""

    def __init__(self, rng: np.random.Generator) -> None:
        own, arm = near(rng, 2.5e-3, 1.5), near(rng, 0.12)
        natural_hz = rng.uniform(1.5, 3.0)
        self.natural_hz = natural_hz
        held = own + 0.1 * arm**2
        loop = float(f"{held * (2 * np.pi * natural_hz) ** 2:.4g}")
        known = rng.random() < 0.5
        self.payloads = (0.05, 0.1, 0.2) if rng.random() < 0.5 else (0.0, 0.08, 0.16, 0.24)
        super().__init__(
            name="payload-arm",
            states=("angle", "rate"),
            inputs=(Signal("command", "rad", draw_between(rng)),),
            outputs=(
                Signal("angle", "rad", equation="angle"),
                Signal("motor_torque", "N m", equation="loop_gain*(command - angle) - loop_damping*rate"),
            ),
            parameters=(
                Parameter("inertia", own, 0.0 if known else 0.05, "kg m^2"),
                Parameter("own_gravity", near(rng, 0.05, 1.5), 0.03, "N m"),
                Parameter("arm", arm, 0.0, "m"),
                Parameter("loop_gain", loop, "free", "N m/rad"),
                Parameter(
                    "loop_damping",
                    float(f"{rng.uniform(0.3, 0.8) * np.sqrt(loop * held):.4g}"),
                    "free",
                    "N m s/rad",
                ),
            ),
            equations={
                "angle": "rate",
                "rate": "(loop_gain*(command - angle) - loop_damping*rate + force.shaft"
                " - (own_gravity + 9.80665*payload_kg*arm)*sin(angle)) / (inertia + payload_kg*arm^2)",
            },
            sites=(
                Site(
                    "shaft",
                    "joint",
                    "angle",
                    "rate",
                    load="(own_gravity + 9.80665*payload_kg*arm)*sin(angle)",
                    effects=(
                        *_JOINT,
                        "load-dependent-friction",
                        "viscous-damping",
                        "constant-force",
                        *only_if(known, "added-inertia"),
                    ),
                ),
            ),
            initial={"angle": 0.0, "rate": 0.0},
            conditions=("payload_kg",),
            input_effects={"command": (*_INPUT, "bias", "gain-error")},
            output_effects={
                "angle": (*_OUTPUT, "bias", "gain-error", "cross-talk"),
                "motor_torque": (*_OUTPUT, "bias", "gain-error", "cross-talk"),
            },
        )

    def _gravity(self, x: FloatArray, p: Values) -> FloatArray:
        return np.asarray((p["own_gravity"] + _G * p["payload_kg"] * p["arm"]) * np.sin(x[0]))

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        pull = (
            p["loop_gain"] * (u[0] - x[0]) - p["loop_damping"] * x[1] + force["shaft"] - self._gravity(x, p)
        )
        return np.array([x[1], pull / (p["inertia"] + p["payload_kg"] * p["arm"] ** 2)])

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        return np.array([x[0], p["loop_gain"] * (u[0] - x[0]) - p["loop_damping"] * x[1]])

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        return At(x[0], x[1], self._gravity(x, p), np.zeros_like(x[0]))

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        base = driven(rng, trials, time_base(rng), [np.deg2rad(rng.uniform(25, 60))], self.natural_hz * 0.5)
        for index, condition in enumerate(base.conditions):
            condition["payload_kg"] = self.payloads[index % len(self.payloads)]
        return base


class LinearStage(Plant):
    """A carriage pushed by a force: metres and newtons; some on a spring, some with a speed sensor."""

    def __init__(self, rng: np.random.Generator) -> None:
        mass, natural_hz = near(rng, 6.0, 1.6), rng.uniform(0.6, 2.0)
        spring = float(f"{mass * (2 * np.pi * natural_hz) ** 2:.4g}")
        self.sprung = rng.random() < 0.6
        self.tacho = rng.random() < 0.5
        self.natural_hz, self.push = natural_hz, spring * near(rng, 0.02)
        known = rng.random() < 0.5
        names = ("stiffness*position + " if self.sprung else "") + "damping*speed"
        damping = float(f"{rng.uniform(0.1, 0.5) * np.sqrt(spring * mass):.4g}")
        site_spring = self.sprung and rng.random() < 0.5
        super().__init__(
            name="linear-stage",
            states=("position", "speed"),
            inputs=(Signal("force", "N", draw_between(rng)),),
            outputs=(
                Signal("position", "m", equation="position"),
                *only_if(self.tacho, Signal("speed_sensor", "m/s", equation="speed")),
            ),
            parameters=(
                Parameter("mass", mass, 0.0 if known else 0.05, "kg"),
                *only_if(self.sprung, Parameter("stiffness", spring, "free", "N/m")),
                Parameter("damping", damping, "free", "N s/m"),
            ),
            equations={"position": "speed", "speed": f"(force + force.carriage - ({names})) / mass"},
            sites=(
                Site(
                    "carriage",
                    "joint",
                    "position",
                    "speed",
                    "stiffness" if site_spring else "",
                    effects=(
                        *_JOINT,
                        *only_if(site_spring, "backlash"),
                        *only_if(not site_spring, "constant-force"),
                    ),
                ),
            ),
            initial={"position": 0.0, "speed": 0.0} if self.sprung else {"position": "free", "speed": 0.0},
            input_effects={
                "force": (
                    "saturation",
                    "rate-limit",
                    "dead-band",
                    *only_if(self.tacho, "lag", "delay"),
                    *only_if(not site_spring, "bias"),
                )
            },
            output_effects={"position": ("saturation", "drift", *only_if(self.tacho, "lag", "delay"))}
            | (
                {"speed_sensor": ("lag", "delay", "bias", "drift", "saturation", "gain-error", "cross-talk")}
                if self.tacho
                else {}
            ),
        )

    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        pull = u[0] + force["carriage"] - p["damping"] * x[1]
        if self.sprung:
            pull = pull - p["stiffness"] * x[0]
        return np.array([x[1], pull / p["mass"]])

    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        return x.copy() if self.tacho else x[:1].copy()

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        none = np.zeros_like(x[0])
        return At(x[0], x[1], none, p["stiffness"] if self.sprung else none)

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.push * rng.uniform(0.7, 1.3)], self.natural_hz)
