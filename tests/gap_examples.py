"""Diagnoses as an engine would give them, of a pendulum on a hinge, a static relation and a single condition."""

from dataclasses import replace
from functools import cache

import numpy as np

from labrun.gap.diagnosis import (
    Cause,
    ComparedTrace,
    Diagnosis,
    MissingForce,
    Name,
    Place,
    RatedCandidate,
    ResampledNumber,
    Rest,
    Rung,
    Shrinkage,
    Sizes,
)

RATE_HZ = 120.0
NOISE_RAD = 4e-3
COULOMB = Name("coulomb-friction", "hinge")
STRIBECK = Name("stribeck-friction", "hinge")
LAG = Name("lag", "torque")
DELAY = Name("delay", "torque")
BACKLASH = Name("backlash", "hinge")
INERTIA = Name("inertia", "inertia", "parameter")


@cache
def swing(release_rad, friction=0.0, stiffness=1.43e-2, duration_s=6.0):
    """Angle, rate and friction of a pendulum that is let go, by small Euler steps; arrays (n,)."""
    inner, steps = 8, int(duration_s * RATE_HZ)
    angle, rate, dt = release_rad, 0.0, 1.0 / (RATE_HZ * 8)
    rows = np.empty((steps, 3))
    for n in range(steps):
        rows[n] = angle, rate, -friction * np.tanh(rate / 0.05)
        for _ in range(inner):
            force = -friction * np.tanh(rate / 0.05)
            rate += dt * (force - stiffness * angle - 4.4e-5 * rate - 6.61e-3 * np.sin(angle)) / 3.9e-5
            angle += dt * rate
    return np.arange(steps) / RATE_HZ, rows


def trace(release_deg, seed, friction=1.5e-4):
    time_s, truth = swing(np.radians(release_deg), friction)
    rng = np.random.default_rng(seed)
    _, raw = swing(np.radians(release_deg), 0.0, 1.38e-2)
    _, recalibrated = swing(np.radians(release_deg), 0.0, 1.43e-2)
    noise = NOISE_RAD * rng.standard_normal((len(time_s), 1)) / np.sqrt(3)
    return ComparedTrace(
        label=f"release = {release_deg:g}",
        condition={"release": float(release_deg)},
        repeats=3,
        time_s=time_s,
        inputs=np.empty((len(time_s), 0)),
        measured=truth[:, :1] + noise,
        raw=raw[:, :1],
        recalibrated=recalibrated[:, :1],
        after=truth[:, :1],
    )


def missing_at_hinge(law=lambda angle, rate: -1.5e-4 * np.tanh(rate / 0.05), share=0.93):
    units = [swing(np.radians(release), 1.5e-4) for release in (10, 30, 50)]
    rng = np.random.default_rng(4)
    return MissingForce(
        site="hinge",
        unit="N m",
        share=share,
        labels=("release = 10", "release = 30", "release = 50"),
        time_s=tuple(time_s for time_s, _ in units),
        force=tuple(law(rows[:, 0], rows[:, 1]) + 4e-5 * rng.standard_normal(len(rows)) for _, rows in units),
        coordinate=tuple(rows[:, 0] for _, rows in units),
        rate=tuple(rows[:, 1] for _, rows in units),
        load=tuple(6.61e-3 * np.sin(rows[:, 0]) for _, rows in units),
        coordinate_unit="rad",
        load_unit="N m",
    )


WHERE = (
    Place("frequency", "2 to 4 Hz", 0.91, 0.005, "frequencies of 2 to 4 Hz"),
    Place("condition", "release = 10", 0.44, 0.005, "at release 10"),
    Place("condition", "release = 20", 0.27, 0.005, "at release 20"),
    Place("reversal", "away from reversals of angle", 0.78, 0.01, "what is away from reversals of angle"),
    Place(
        "state", "hinge: positive, falling", 0.27, 0.01, "the falling motion on the positive side of hinge"
    ),
    Place(
        "state", "hinge: negative, falling", 0.26, 0.01, "the falling motion on the negative side of hinge"
    ),
    Place("state", "hinge: negative, rising", 0.24, 0.02, "the rising motion on the negative side of hinge"),
    Place("phase", "falling hinge", 0.53, 0.02, "the half of the cycle in which hinge falls"),
    Place("phase", "rising hinge", 0.47, 0.03, "the half of the cycle in which hinge rises"),
    Place("channel", "angle", 1.0, 0.005, "the angle"),
    Place("phase", "falling hinge | release = 10", 0.31, 0.01, "falling half of the cycle at release 10"),
    Place("condition", "release = 30", 0.16, 0.21, "at release 30"),
    Place("condition", "release = 40", 0.09, 0.42, "at release 40"),
    Place("condition", "release = 50", 0.04, 0.78, "at release 50"),
    Place("frequency", "below 2 Hz", 0.06, 0.34, "frequencies below 2 Hz"),
    Place("frequency", "above 4 Hz", 0.03, 0.9, "frequencies above 4 Hz"),
    Place("reversal", "angle", 0.22, 0.14, "the 100 ms before and after reversals of angle"),
    Place("state", "hinge: positive, rising", 0.23, 0.09, "the rising motion on the positive side of hinge"),
)


def bound(value, unit):
    return ResampledNumber(value, 0.0, value, unit)


def excluded(effect, site, closes, **bounds):
    return RatedCandidate(Name(effect, site), "excluded", closes, upper_bound=bounds)


def ladder(outputs, *steps):
    """Rungs from (step, cause, error in multiples of the noise, share closed); `outputs` maps names to noise."""
    return tuple(
        Rung(step, cause, {name: in_noise * sd for name, sd in outputs.items()}, in_noise, closes)
        for step, cause, in_noise, closes in steps
    )


OTHERS = (
    excluded("viscous-damping", "hinge", 0.31, coefficient=bound(1.1e-5, "N m s/rad")),
    excluded("quadratic-drag", "hinge", 0.12, coefficient=bound(6e-6, "N m s^2/rad^2")),
    excluded("cubic-stiffness", "hinge", 0.05, coefficient=ResampledNumber(0.0, -4e-4, 5e-4, "N m/rad^3")),
    excluded("backlash", "hinge", 0.08, gap=bound(0.0021, "rad")),
    excluded("rest-offset", "hinge", -0.02, offset=ResampledNumber(0.0, -0.002, 0.003, "rad")),
    RatedCandidate(Name("added-inertia", "hinge"), "not-visible", remark="looks like the parameter inertia"),
    RatedCandidate(Name("end-stop", "hinge"), "not-visible", remark="the motion never comes near a stop"),
    excluded("saturation", "angle", 0.0, level=ResampledNumber(0.88, 0.88, 1.3, "rad")),
    excluded("lag", "angle", 0.03, time=bound(0.0008, "s")),
    excluded("delay", "angle", 0.03, time=bound(0.0007, "s")),
    excluded("bias", "angle", 0.01, bias=ResampledNumber(0.0, -0.0004, 0.0005, "rad")),
    RatedCandidate(INERTIA, "not-needed", 0.02),
)


def explained():
    friction = ResampledNumber(1.52e-4, 1.44e-4, 1.59e-4, "N m")
    return Diagnosis(
        name="hinge-20260714T101500Z-k3f9",
        model="hinge-pendulum",
        source="results/hinge/hinge-20260714T101500Z-k3f9",
        verdict="explained",
        sentence="The gap is dry friction at the hinge (coulomb-friction) of 0.15 mN m: with it, only noise is left.",
        gap=Sizes(9.1, 4.2, 0.62, 0.8),
        where=WHERE,
        causes=(Cause(COULOMB, 0.96, {"torque": friction}, 0.85, 0.85),),
        differs=(),
        candidates=(*OTHERS, RatedCandidate(COULOMB, "cause", 0.85, {"torque": friction})),
        shrinkage=Shrinkage(0.97, 0.94, 0.99),
        recalibration={
            "inertia": (3.9e-5, 0.03, 3.94e-5),
            "gravity_torque": (6.61e-3, 0.03, 6.5e-3),
            "stiffness": (1.43e-2, "free", 1.39e-2),
            "damping": (4.4e-5, "free", 7.9e-5),
        },
        corrected={"inertia": 3.9e-5, "gravity_torque": 6.6e-3, "stiffness": 1.431e-2, "damping": 4.5e-5},
        effects=(),
        limitations=("No input drives this model, so nothing is said of effects at an input.",),
        notes=("The simulation at a quarter of the step differs by 0.02 of the noise of one trial.",),
        what_next=("Write the corrected model with --save-model FILE and use it in the next dry run.",),
        channels=(("angle", "rad"),),
        input_channels=(),
        noise={"angle": NOISE_RAD},
        trials=15,
        conditions=5,
        repeats=3,
        missing=(missing_at_hinge(),),
        traces=(trace(10, 0), trace(30, 1), trace(50, 2)),
        parameter_units={
            "inertia": "kg m^2",
            "gravity_torque": "N m",
            "stiffness": "N m/rad",
            "damping": "N m s/rad",
        },
        seed=0,
        seconds=14.2,
        ladder=ladder(
            {"angle": NOISE_RAD},
            ("as stated", None, 9.1, 0.0),
            ("recalibrated", None, 4.2, 0.0),
            ("+ Coulomb friction at hinge", COULOMB, 0.62, 0.85),
        ),
        rest=Rest(0.62, 0.15, within_noise=True),
    )


def parameter():
    number = ResampledNumber(5.1e-5, 5.0e-5, 5.2e-5, "kg m^2")
    return replace(
        explained(),
        sentence="Parameter inertia closes 88 % of the gap; the rest (0.5 times the noise) is within the noise.",
        gap=Sizes(9.1, 4.1, 0.5, 0.8),
        causes=(Cause(INERTIA, 0.93, {"inertia": number}, 0.88, 0.88, remark="1.31 times the stated value"),),
        candidates=(RatedCandidate(INERTIA, "cause", 0.88, {"inertia": number}), *OTHERS[:-1]),
        recalibration={**explained().recalibration, "inertia": (3.9e-5, 0.03, 5.1e-5)},
        missing=(),
        ladder=ladder(
            {"angle": NOISE_RAD},
            ("as stated", None, 9.1, 0.0),
            ("recalibrated", None, 4.1, 0.0),
            ("+ parameter inertia", INERTIA, 0.5, 0.88),
        ),
        rest=Rest(0.5, 0.12, within_noise=True),
    )


def no_gap():
    return replace(
        explained(),
        verdict="no-gap",
        sentence="Model and measurement agree within the noise once the parameters are recalibrated.",
        gap=Sizes(2.2, 0.3, 0.3, 0.8),
        where=tuple(replace(location, p=None if location.p is None else 0.5) for location in WHERE),
        causes=(),
        candidates=OTHERS,
        shrinkage=None,
        ladder=explained().ladder[:2],
        rest=Rest(0.3, 1.0, within_noise=True),
        limitations=(),
        notes=(),
        what_next=("Nothing: the model is as good as these data can tell.",),
        missing=(),
    )


def unexplained():
    return replace(
        explained(),
        verdict="unexplained",
        sentence="No cause in the library improves the prediction of data that the fit has not seen; 4.2 times the "
        "noise is left.",
        gap=Sizes(9.1, 4.2, 4.2, 0.8),
        causes=(),
        candidates=(RatedCandidate(STRIBECK, "not-needed", 0.02), *OTHERS),
        ladder=explained().ladder[:2],
        rest=Rest(4.2, 1.0, 0.8, ("position of hinge", "angle")),
        shrinkage=None,
        what_next=("Look at the missing force against the position of the hinge: it repeats every 14 deg.",),
        missing=(missing_at_hinge(lambda angle, rate: 2e-4 * np.sin(angle / 0.04), 0.88),),
    )


def pair():
    friction, lag = (
        ResampledNumber(1.52e-4, 1.44e-4, 1.59e-4, "N m"),
        ResampledNumber(0.031, 0.027, 0.036, "s"),
    )
    return replace(
        explained(),
        verdict="partly-explained",
        sentence="Two causes explain 81 % of the gap: dry friction at the hinge, and a lag or a delay of the torque; "
        "what is left is beyond the noise.",
        gap=Sizes(31.0, 12.4, 4.9, 0.8),
        causes=(
            Cause(COULOMB, 0.91, {"torque": friction}, 0.42, 0.48, (STRIBECK,)),
            Cause(LAG, 0.55, {"time": lag}, 0.19, 0.19, (DELAY,), {"order": (1.0, "1")}, "at its upper bound"),
        ),
        candidates=(
            RatedCandidate(COULOMB, "cause", 0.42, {"torque": friction}, same_as=(STRIBECK,)),
            RatedCandidate(LAG, "cause", 0.2, {"time": lag}, same_as=(DELAY,)),
            RatedCandidate(STRIBECK, "rival", 0.41, same_as=(COULOMB,)),
            RatedCandidate(DELAY, "rival", 0.19, same_as=(LAG,)),
            *OTHERS,
        ),
        shrinkage=Shrinkage(0.81, 0.72, 0.88),
        ladder=ladder(
            {"angle": NOISE_RAD},
            ("as stated", None, 31.0, 0.0),
            ("recalibrated", None, 12.4, 0.0),
            ("+ Coulomb friction at hinge", COULOMB, 7.2, 0.42),
            ("+ lag at torque", LAG, 4.9, 0.19),
        ),
        rest=Rest(4.9, 0.4, 0.3, ("speed of hinge",)),
        limitations=(
            "Two repeats of each condition: the noise floor is known to 30 % only.",
            "These data cannot tell lag from delay: the fastest motion is far below 1/(2 pi 31 ms) = 5 Hz.",
            "The lag stands at its upper bound, so that its size is not known.",
        ),
        what_next=(
            "labrun gap next hinge writes an experiment of 4 min that tells a lag from a delay.",
            "Repeat each condition five times, to know the noise.",
        ),
    )  # fmt: skip


def static():
    """A relation without states: torque extremes at four frequencies, one sample each."""

    def reading(frequency_hz, measured, simulated, after):
        column = np.array([measured])
        return ComparedTrace(
            label=f"frequency_hz = {frequency_hz:g}",
            condition={"frequency_hz": frequency_hz},
            repeats=1,
            time_s=np.zeros(1),
            inputs=np.array([[frequency_hz]]),
            measured=column,
            raw=np.array([simulated]),
            recalibrated=np.array([simulated]) * 1.05,
            after=np.array([after]),
        )

    bound_nm = ResampledNumber(0.31, 0.22, 0.41, "1")
    cause = Cause(Name("gain-error", "recovery_torque"), 0.71, {"gain": bound_nm}, 0.73, 0.73)
    return replace(
        explained(),
        name="fin-torque-extremes",
        model="fin-torque",
        source="recordings/fin-torque-extremes",
        verdict="explained",
        sentence="The recovery stroke is 31 % weaker than the model says from 0.3 Hz on; the power stroke agrees.",
        where=(
            Place(
                "condition",
                "recovery_torque | frequency_hz >= 0.3",
                0.79,
                None,
                "the recovery torque from 0.3 Hz on",
            ),
            Place("channel", "recovery_torque", 0.83, None, "the recovery torque"),
            Place("condition", "frequency_hz = 0.4", 0.51, None, "at 0.4 Hz"),
            Place("condition", "frequency_hz = 0.3", 0.39, None, "at 0.3 Hz"),
            Place("channel", "power_torque", 0.17, None, "the power torque"),
            Place("condition", "frequency_hz = 0.2", 0.08, None, "at 0.2 Hz"),
            Place("condition", "frequency_hz = 0.1", 0.02, None, "at 0.1 Hz"),
        ),
        causes=(cause,),
        candidates=(RatedCandidate(cause.name, "cause", 0.73, dict(cause.values)),),
        gap=Sizes(5.1, 3.3, 0.9, 1.0),
        shrinkage=Shrinkage(0.74, 0.4, 0.9),
        recalibration={"drag": (1.2, 0.1, 1.26)},
        corrected={"drag": 1.21},
        parameter_units={"drag": "1"},
        channels=(("power_torque", "N m"), ("recovery_torque", "N m")),
        input_channels=(("frequency", "Hz"),),
        noise={"power_torque": 0.05, "recovery_torque": 0.05},
        ladder=ladder(
            {"power_torque": 0.05, "recovery_torque": 0.05},
            ("as stated", None, 5.1, 0.0),
            ("recalibrated", None, 3.3, 0.0),
            (f"+ {cause.name.words}", cause.name, 0.9, 0.73),
        ),
        rest=Rest(0.9, 0.27),
        trials=4,
        conditions=4,
        repeats=1,
        missing=(),
        traces=(
            reading(0.1, [0.31, -0.28], [0.3, -0.29], [0.3, -0.28]),
            reading(0.2, [0.74, -0.65], [0.75, -0.72], [0.74, -0.66]),
            reading(0.3, [1.32, -0.85], [1.3, -1.25], [1.31, -0.88]),
            reading(0.4, [2.1, -1.2], [2.05, -1.96], [2.06, -1.25]),
        ),
        limitations=("No condition was repeated: gap and noise cannot be told apart for certain.",),
    )


def single_condition():
    return replace(
        explained(),
        name="ring-down",
        conditions=1,
        trials=1,
        repeats=1,
        shrinkage=None,
        gap=Sizes(210.0, 88.0, 1.1, 1.0),
        where=tuple(location for location in WHERE if location.by != "condition"),
        limitations=(
            "A single trial: gap and noise are told apart by frequency only.",
            "One condition: nothing is left to check the cause on.",
        ),
        traces=(trace(50, 2),),
    )


ALL = {
    "explained": explained,
    "parameter": parameter,
    "no-gap": no_gap,
    "unexplained": unexplained,
    "pair": pair,
    "static": static,
    "single-condition": single_condition,
}
