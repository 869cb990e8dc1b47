"""From the tables of an experiment to the numbers of a compiled loop, or why it cannot be compiled."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.control.compiled.stepping import AFFINE, PID, Affine, Law, Pid, Wiring
from labrun.control.feedbacks import LatestFeedback, OrientationFeedback
from labrun.control.inverse import InverseController
from labrun.control.making import OneForEach
from labrun.control.network import KEPT_SAMPLES, NetworkController
from labrun.control.pid import PidController
from labrun.control.protocol import Feedback, LoopContext
from labrun.devices import Limits
from labrun.errors import SpecError
from labrun.gaits import Steering

_LONGEST_S, _LOOK_S = 3600.0, 0.25
_HINT = "leave out track.compiled, and the loop is run by Python, which holds some 160 steps a second"
_ANTI_WINDUP = {"none": 0.0, "conditional": 1.0, "back-calculation": 2.0}


@dataclass(frozen=True, slots=True)
class Channels:
    """Where the channels of a rig stand when all sensors' are put in one row.

    Attributes
    ----------
    sensors
        Names of the sensors, in their order.
    places
        ``device.channel`` -> place in the row.
    """

    sensors: tuple[str, ...]
    places: Mapping[str, int]

    def sensor_of(self, channel: str) -> int:
        """Return the number of the sensor a channel is of."""
        return self.sensors.index(channel.partition(".")[0])


def refusal(what: str) -> SpecError:
    """Return the error for what has no compiled form."""
    return SpecError(f"a compiled loop does not know {what}", hint=_HINT)


def law_of(controller: object, context: LoopContext, wiring: Wiring, channels: Channels) -> Law:
    """Return a loop under its controller, new. Raises SpecError: a controller without a compiled form."""
    none = _affine(np.zeros((2, 1)), (), (), 1)
    if isinstance(controller, OneForEach):
        plain = [one for one in controller.controllers if isinstance(one, PidController)]
        if all(type(one) is PidController for one in controller.controllers):
            return Law(wiring, PID, _pid(plain), none)
    no_pid = Pid(np.zeros((1, 9)), np.zeros((1, 4)), False)
    if isinstance(controller, NetworkController):
        return Law(wiring, AFFINE, no_pid, _network(controller, channels))
    if isinstance(controller, InverseController):
        drives = len(context.drives)
        affine = _affine(np.zeros((1, drives)), (), range(drives), 1)._replace(
            nominal=_address(controller.inverse, "its inverse")
        )
        return Law(wiring, AFFINE, no_pid, affine)
    raise refusal("this controller: network, inverse and pid have a compiled form")


def wiring_of(
    feedbacks: Sequence[Feedback],
    context: LoopContext,
    channels: Channels,
    tare: Mapping[str, float],
    most: float,
    gait: FloatArray,
    limits: Sequence[Limits],
) -> Wiring:
    """Return what a loop reads and moves.

    Parameters
    ----------
    most
        How far a drive may go in a step.
    gait : (joints, drives + 1)
        See `straight_gait`.
    limits
        Of each joint's device.

    Raises
    ------
    SpecError
        A feedback without a compiled form.
    """
    orientation = len(feedbacks) == 1 and isinstance(feedbacks[0], OrientationFeedback)
    names: list[str] = []
    scale: list[float] = []
    for one in feedbacks:
        if orientation:
            names, scale = list(one.channels), [1.0] * len(one.channels)
        elif type(one) is LatestFeedback and len(one.channels) == 1:
            names.append(one.channels[0])
            scale.append(one.factor)
        else:
            raise refusal("this feedback: latest (of one channel) and orientation have a compiled form")
    bounds = [one.angle_deg or (-math.inf, math.inf) for one in limits]
    speeds = [math.inf if one.speed_deg_s is None else one.speed_deg_s for one in limits]
    return Wiring(
        np.array([channels.places[name] for name in names]),
        np.array([channels.sensor_of(name) for name in names]),
        np.array(scale),
        np.array([tare.get(name, 0.0) for name in names]),
        orientation,
        context.low,
        context.high,
        most,
        np.ascontiguousarray(gait),
        np.radians([low for low, _ in bounds]),
        np.radians([high for _, high in bounds]),
        np.radians(speeds) * context.period_s,
        np.zeros(7, dtype=np.int64),
    )


def straight_gait(steering: Steering, drives: Sequence[str], within: tuple[float, float]) -> FloatArray:
    """Return the angles of a gait that is straight in its drives at all times, (joints, drives + 1), rad.

    Looked at every 0.25 s of an hour, with drives all over their range `within`. Raises SpecError: it is not: its
    angles depend on time, or bend.
    """
    probes = np.vstack([np.zeros(len(drives)), np.eye(len(drives))])
    values = {name: probes[:, column] for column, name in enumerate(drives)}
    found = np.array(steering(np.zeros(len(probes)), values), dtype=float)
    constant, slopes = found[0], found[1:] - found[0]
    later_s = np.arange(0.0, _LONGEST_S, _LOOK_S)
    low, high = within
    here = low + 0.5 * (high - low) * (1.0 + np.sin(np.outer(later_s, np.sqrt(1.0 + np.arange(len(drives))))))
    later = np.array(steering(later_s, dict(zip(drives, here.T, strict=True))), dtype=float)
    if not np.allclose(later, constant + here @ slopes, atol=1e-9):
        raise refusal("a gait that moves by itself, or bends: each joint is a sum of drives times a number")
    return np.column_stack([slopes.T, constant])


def _network(controller: NetworkController, channels: Channels) -> Affine:
    network, learning = controller.network, controller.learning
    try:
        start = network.collapsed()
    except ValueError as error:
        raise refusal(f"this network: {error}") from error
    (weight,), (bias,) = start.weights, start.biases
    window = 0 if learning is None or learning.window is None else learning.window * learning.every
    affine = _affine(np.vstack([weight, bias]), controller.order, controller.places, max(1, window))
    affine = affine._replace(
        input_mean=start.inputs.mean.astype(float),
        input_scale=start.inputs.scale.astype(float),
        output_mean=start.outputs.mean.astype(float),
        output_scale=start.outputs.scale.astype(float),
        nominal=0 if controller.nominal is None else _address(controller.nominal, "the inverse it corrects"),
    )
    if learning is None:
        return affine
    return affine._replace(
        measured=np.array([channels.places[name] for name in learning.channels]),
        measured_sensor=np.array([channels.sensor_of(name) for name in learning.channels]),
        factor=np.array(learning.factors, dtype=float),
        history_s=learning.history_s,
        every=learning.every,
        ridge=float(learning.ridge),
        learns=True,
    )


def _affine(weights: FloatArray, order: Sequence[int], places: Sequence[int], window: int) -> Affine:
    size, outs = weights.shape
    none = np.zeros(outs, dtype=np.int64)
    return Affine(
        np.ascontiguousarray(weights, dtype=float),
        np.array(weights, dtype=float, order="C"),
        np.zeros((size, size)),
        np.zeros((size, outs)),
        np.zeros((window, size)),
        np.zeros((window, outs)),
        np.zeros(window),
        np.zeros(size - 1),
        np.ones(size - 1),
        np.zeros(outs),
        np.ones(outs),
        np.array(order, dtype=np.int64),
        np.array(places, dtype=np.int64),
        0,
        none,
        none.copy(),
        np.ones(outs),
        np.zeros(KEPT_SAMPLES),
        np.zeros((KEPT_SAMPLES, outs)),
        np.array([-math.inf, 0.0]),
        np.zeros(7, dtype=np.int64),
        0.0,
        1,
        0.0,
        False,
    )


def _pid(controllers: Sequence[PidController]) -> Pid:
    rows = []
    for one in controllers:
        keys = one.keys
        rows.append(
            [
                keys.p, keys.i, keys.d, float(keys.i_per == "second"), keys.bias,
                float(keys.derivative_on == "error"), one.filter_s, _ANTI_WINDUP[keys.anti_windup],
                one.tracking_s,
            ]
        )  # fmt: skip
    increment = {one.keys.output for one in controllers} == {"increment"}
    return Pid(np.array(rows), np.zeros((len(rows), 4)), increment)


def _address(inverse: object, what: str) -> int:
    compiled = getattr(inverse, "compiled", None)
    if compiled is None:
        raise refusal(f"{what}, which has no compiled form (an attribute `compiled`)")
    return int(compiled.address)
