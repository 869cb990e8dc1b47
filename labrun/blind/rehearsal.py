"""Simulate a few trials with a hidden effect, to see what it would change."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.blind.seal import PARAMETER
from labrun.devices import Scene, Trajectory
from labrun.effects import Scale
from labrun.errors import ExperimentError, RequestError
from labrun.experiment import Experiment, SceneTable, Value
from labrun.models import Model, Site
from labrun.runner import MotionMaker, Rig, SimulatedClock, TrialMotion, smooth_move

_KEYS = ("effect", "site", "kind", "values")


class HidingScene(Scene, Protocol):
    """A simulated bench that can hide effects."""

    scale: Scale
    """Typical magnitudes on the bench."""

    @property
    def places(self) -> Sequence[Site]:
        """Sites of the scene: driven joints, bodies, signals."""
        ...


def concealed(
    experiment: Experiment,
    hidden: Sequence[Mapping[str, Any]],
    *,
    noise: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Experiment:
    """Return an experiment whose scene equals its model plus the hidden effects.

    Parameters
    ----------
    hidden
        Effects and true values of parameters, see `labrun.blind.hiding.choose_hidden`.
    noise
        Instead of the scene's own factor.
    parameters
        Relative errors of the scene's parameters, in addition to its own.

    Raises
    ------
    RequestError
        The experiment has no scene.
    """
    scene = _named_scene(experiment)
    settings: dict[str, Any] = {
        **scene.settings,
        "hide": [{key: effect[key] for key in _KEYS} for effect in hidden if effect["kind"] != PARAMETER],
        "as_modelled": True,
    }
    if noise is not None:
        settings["noise"] = noise
    if parameters:
        own = settings.get("parameters", {})
        settings["parameters"] = {
            **own, **{name: (1 + own.get(name, 0.0)) * (1 + error) - 1 for name, error in parameters.items()}
        }  # fmt: skip
    true = {
        name: value
        for effect in hidden
        if effect["kind"] == PARAMETER
        for name, value in effect["values"].items()
    }
    if true:
        settings["true_parameters"] = {**settings.get("true_parameters", {}), **true}
    table = SceneTable.model_validate({"plugin": scene.plugin, **settings})
    return experiment.model_copy(update={"rig": experiment.rig.model_copy(update={"scene": table})})


def hiding_scene(experiment: Experiment) -> HidingScene:
    """Return the scene of an experiment. Raises RequestError: it names none, or one that cannot hide anything."""
    name = _named_scene(experiment).plugin
    rig = Rig.build(concealed(experiment, []), clock=SimulatedClock(), seed=0, dry_run=True)
    scene: Any = rig.scene
    if not (hasattr(scene, "places") and hasattr(scene, "scale")):
        raise RequestError(f"scene {name!r} cannot hide effects: it names no sites")
    hiding: HidingScene = scene
    return hiding


def _named_scene(experiment: Experiment) -> SceneTable:
    if experiment.rig.scene is None:
        raise RequestError(
            "no simulated bench to hide an effect in",
            hint='name one: [rig] scene = "..."; the plain one has no physics',
        )
    return experiment.rig.scene


_CONDITIONS = 3
_RATE_HZ = 100.0
_MOST_SAMPLES = 10_000
"""Of one trial: one that takes longer is looked at less often."""
_READ_S = 60.0
"""A bench remembers two minutes: it is read in stretches of so long."""
_QUIET_S = 20.0
"""Before a trial: for the move to where it begins, and for what the one before left behind."""
_MOVE_RAD_S = 0.5
_STEP = 0.01
"""Relative change of a parameter for its sensitivity."""
_FARTHEST = 0.5
"""Greatest relative change of a parameter in one step of a recalibration."""
_BEGINNINGS = (0.1, 0.2, 0.4, 0.7, 1.0, 1.0)
_FORCES = ("N", "N m")
_QUIET = 0.01
"""The scatter counts as at least this share of a signal: sensors, which are not asked here, have noise of their own."""
_SWAMPED = 1.0
"""Greatest root mean square of the change, in units of the signals' spread."""


class Rehearsal:
    """Compares the bench with and without what is to be hidden, over a few conditions.

    What counts of a change is what is left once errors of the model's own parameters, and where a swing begins if the
    model leaves that free, have explained what they can.

    Parameters
    ----------
    experiment
        With its scene.
    model
        Which will be compared with the run; the scene's parameters of the same names count as known only roughly.
    conditions
        What the run measures; a few of them are rehearsed.
    """

    def __init__(
        self, experiment: Experiment, model: Model, conditions: Sequence[Mapping[str, Value]]
    ) -> None:
        self._experiment = experiment
        count = min(_CONDITIONS, len(conditions))
        chosen = [conditions[i] for i in np.linspace(0, len(conditions) - 1, count).round().astype(int)]
        maker = MotionMaker(experiment)
        self._motions = [(dict(condition), maker.motion(condition)) for condition in chosen]
        scene = hiding_scene(experiment)
        shown = {**{name: name for name in scene.signals}, **getattr(scene, "shown_by", {})}
        outputs = [shown[output.name] for output in model.outputs if output.name in shown]
        self._signals = outputs or [name for name in scene.signals if name not in scene.joints]
        self._signals = self._signals or list(scene.signals)
        self._forces = np.array([scene.signals[name] in _FORCES for name in self._signals])
        self._forces &= experiment.trial.tare is not None
        rig = Rig.build(concealed(experiment, []), clock=SimulatedClock(), seed=0, dry_run=True)
        self._bounds = np.array([_bound(rig, scene.signals[name]) for name in self._signals])
        self._plain = self._signals_with([])
        self._spread = np.array([np.std(column) for column in self._stacked(self._plain)])
        self._moves = self._spread > 0
        self._noise = self._scatter()
        known = scene.truth().get("parameters", {})
        self._loose = [
            parameter.name
            for parameter in model.parameters
            if parameter.tolerance != 0 and known.get(parameter.name)
        ]
        self._free_beginning = any(model.initial.get(state, "free") == "free" for state in model.states)
        self._slopes = self._sensitivities(self._plain, dict.fromkeys(self._loose, 0.0))

    def size(self, hidden: Mapping[str, Any]) -> float:
        """Return how large an effect shows in the signal that shows it best, in units of the scatter between trials.

        That is the root mean square of its change, less what recalibration can imitate to first order; infinite where
        the bench blows up, a device's limit would end the run, or the change swamps what it does.
        """
        try:
            signals = self._signals_with([hidden])
        except ExperimentError:  # the bench blew up
            return math.inf
        if np.any(np.abs(np.concatenate(signals)) > self._bounds):
            return math.inf  # the run would end there
        change = _difference(signals, self._plain)
        if not all(np.isfinite(outputs).all() for outputs in change):
            return math.inf
        sizes = np.array([np.sqrt(np.mean(column**2)) for column in self._stacked(change)])
        if np.any(sizes[self._moves] > _SWAMPED * self._spread[self._moves]) or self._harms(hidden):
            return math.inf
        return self._largest(_left(self._whitened(change), self._slopes))

    def _harms(self, hidden: Mapping[str, Any]) -> bool:
        """Tell whether the carriage's way back, which may be faster than the trial, would see much more than it."""
        changed = concealed(self._experiment, [hidden], noise=0.0)
        towed = [motion for motion in self._motions if motion[1].travel is not None]
        back = [way_back for motion in towed if len(way_back := self._way_back(changed, *motion))]
        if not back:
            return False
        most = np.max(np.abs(np.concatenate(back)), axis=0)
        usual = np.max(np.abs(np.concatenate(self._plain)), axis=0)
        return bool(np.any((most > (1.0 + _SWAMPED) * usual)[self._moves]))

    def recalibrated_size(self, hidden: Mapping[str, Any]) -> float:
        """Return the same after a real recalibration: Gauss-Newton steps over a growing beginning of each trial.

        Over the whole of a long swing a frequency that is off by a percent is a phase that is off by a turn, which no
        first step can put right. Nor can it where a trial begins much later, as a strip that is mounted slacker does.
        """
        signals = self._signals_with([hidden])
        errors, plain, slopes = dict.fromkeys(self._loose, 0.0), self._plain, self._slopes
        later = np.zeros(len(plain))
        for share in _BEGINNINGS:
            seen = self._beginning(share)
            white = self._whitened(_difference(signals, plain))
            correction = np.linalg.lstsq(slopes[seen], white[seen], rcond=1e-8)[0]
            steps = np.clip(_STEP * correction[: len(errors)], -_FARTHEST, _FARTHEST)
            errors = {
                name: (1 + error) * (1 + step) - 1
                for (name, error), step in zip(errors.items(), steps.tolist(), strict=True)
            }
            if self._free_beginning:
                later -= correction[len(errors) :: 2]
            try:
                plain = _later(self._signals_with([], errors), later)
                slopes = self._sensitivities(plain, errors, later)
            except ExperimentError:  # so far off that the bench blew up
                break
        return self._largest(_left(self._whitened(_difference(signals, plain)), slopes))

    def apart(self, hidden: Mapping[str, Any], other: Mapping[str, Any]) -> float:
        """Return the size of an effect after another one of any strength is projected out."""
        try:
            signals, others = self._signals_with([hidden]), self._signals_with([other])
        except ExperimentError:  # the bench blew up: they differ
            return math.inf
        columns = np.column_stack([self._slopes, self._whitened(_difference(others, self._plain))])
        white = self._whitened(_difference(signals, self._plain))
        if not (np.isfinite(columns).all() and np.isfinite(white).all()):
            return math.inf
        return self._largest(_left(white, columns))

    def _largest(self, white: FloatArray) -> float:
        """Return the greatest root mean square of any signal that moves."""
        per_signal = white.reshape(len(self._signals), -1)[self._moves]
        return float(np.sqrt(np.mean(per_signal**2, axis=1)).max())

    def _beginning(self, share: float) -> NDArray[np.bool_]:
        """Return which of the whitened numbers belong to the first part of a trial."""
        counts = [len(outputs) for outputs in self._plain]
        first = np.concatenate([np.arange(count) < share * count for count in counts])
        return np.tile(first, len(self._signals))

    def _scatter(self) -> FloatArray:
        """Return the scatter of each signal between two trials of the same condition."""
        noisy = concealed(self._experiment, [], noise=1.0)
        pairs = [self._trials(noisy, *motion, 2) for motion in self._motions]
        between = self._stacked([first - other for first, other in pairs])
        noise = np.array([np.sqrt(np.mean(column**2) / 2) for column in between])
        least: FloatArray = np.maximum(np.maximum(noise, _QUIET * self._spread), 1e-12)
        return least

    def _sensitivities(
        self, plain: Sequence[FloatArray], errors: Mapping[str, float], later: FloatArray | None = None
    ) -> FloatArray:
        """Return what small errors of loose parameters, then of where a swing begins, change; whitened columns."""
        columns = []
        for name in self._loose:
            more = {**errors, name: (1 + errors[name]) * (1 + _STEP) - 1}
            changed = self._signals_with([], more)
            changed = changed if later is None else _later(changed, later)
            columns.append(self._whitened(_difference(changed, plain)))
        for index, outputs in enumerate(plain if self._free_beginning else ()):
            for moved in (np.gradient(outputs, axis=0), outputs):
                alone = [np.zeros_like(other) for other in plain]
                alone[index] = moved
                columns.append(self._whitened(alone))
        sensitivities: FloatArray = np.array(columns).reshape(-1, self._whitened(plain).size).T
        return sensitivities

    def _stacked(self, signals: Sequence[FloatArray]) -> FloatArray:
        """Return the conditions one behind the other, shape (signals, samples)."""
        return np.concatenate(signals).T

    def _whitened(self, signals: Sequence[FloatArray]) -> FloatArray:
        flat: FloatArray = (self._stacked(signals) / self._noise[:, None]).ravel()
        return flat

    def _signals_with(
        self, hidden: Sequence[Mapping[str, Any]], parameters: Mapping[str, float] | None = None
    ) -> list[FloatArray]:
        """Return the signals of each condition, tared where the experiment tares, shape (samples, signals) each."""
        changed = concealed(self._experiment, hidden, noise=0.0, parameters=parameters)
        return [self._trials(changed, *motion, 1)[0] for motion in self._motions]

    def _trials(
        self, experiment: Experiment, condition: Mapping[str, Value], motion: TrialMotion, repeats: int
    ) -> list[FloatArray]:
        rig = Rig.build(experiment, clock=SimulatedClock(), seed=0, dry_run=True)
        with rig:
            scene = rig.scene
            assert scene is not None  # noqa: S101  (`hiding_scene` would have refused)
            scene.arrange(condition)
            scene.observe(self._signals, np.zeros(1))
            trials = [self._trial(rig, scene, motion)]
            while len(trials) < repeats:
                if experiment.by_hand is not None:  # what a person mounts anew for every trial is not worn
                    self._back(rig, scene, motion)
                    getattr(scene, "mount", lambda _: None)(len(trials) + 1)
                trials.append(self._trial(rig, scene, motion))
            return trials

    def _way_back(
        self, experiment: Experiment, condition: Mapping[str, Value], motion: TrialMotion
    ) -> FloatArray:
        """Return the signals while the carriage goes back after a trial."""
        rig = Rig.build(experiment, clock=SimulatedClock(), seed=0, dry_run=True)
        with rig:
            scene = rig.scene
            assert scene is not None  # noqa: S101  (`hiding_scene` would have refused)
            scene.arrange(condition)
            scene.observe(self._signals, np.zeros(1))
            self._trial(rig, scene, motion)
            return self._back(rig, scene, motion)

    def _back(self, rig: Rig, scene: Scene, motion: TrialMotion) -> FloatArray:
        """Bring the carriage to where the trial begins; return the signals on its way."""
        back = motion.travel
        if back is None:
            return np.empty((0, len(self._signals)))
        now_s, from_m = rig.clock.now(), back.to_m
        if _is_free(motion):  # it is wherever it went
            from_m = float(scene.observe(("position",), np.array([now_s]))[0, 0])
        way_s = abs(from_m - back.from_m) / back.return_speed_m_s
        if way_s == 0.0:
            return np.empty((0, len(self._signals)))
        scene.tow(from_m, back.from_m, back.return_speed_m_s, now_s)
        return self._observed(rig, scene, way_s)

    def _observed(self, rig: Rig, scene: Scene, duration_s: float) -> FloatArray:
        """Return the signals of the next so many seconds, and let them pass."""
        start_s, rate_hz = rig.clock.now(), min(_RATE_HZ, _MOST_SAMPLES / duration_s)
        times_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
        pieces = np.split(times_s, np.searchsorted(times_s, np.arange(_READ_S, duration_s, _READ_S)))
        observed = np.concatenate([scene.observe(self._signals, start_s + piece) for piece in pieces])
        rig.clock.sleep(duration_s)
        return observed

    def _trial(self, rig: Rig, scene: Scene, motion: TrialMotion) -> FloatArray:
        trajectory = motion.trajectory
        first = dict(zip(trajectory.joints, trajectory.angle_rad[0], strict=True))
        here = {
            joint: angle for actuator in rig.actuators.values() for joint, angle in actuator.pose().items()
        }
        move = smooth_move(here, first, _MOVE_RAD_S)
        if move is not None:
            _follow(rig, move)
        rig.clock.sleep(_QUIET_S)
        if _is_free(motion):
            self._back(rig, scene, motion)
        start_s = rig.clock.now()
        before = scene.observe(self._signals, start_s + np.arange(-1.0, 0.0, 1 / _RATE_HZ))
        _follow(rig, trajectory)
        if motion.travel is not None:
            travel = motion.travel
            ramps = () if travel.acceleration_m_s2 is None else (travel.acceleration_m_s2,)
            scene.tow(travel.from_m, travel.to_m, travel.speed_m_s, start_s, *ramps)
        signals = self._observed(rig, scene, motion.duration_s)
        tared: FloatArray = signals - np.where(self._forces, before.mean(axis=0), 0.0)
        return tared


def _is_free(motion: TrialMotion) -> bool:
    """Tell whether the carriage goes where the trial takes it, and is only brought back."""
    return motion.travel is not None and motion.travel.to_m == motion.travel.from_m


def _bound(rig: Rig, unit: str) -> float:
    """Return the largest value of a signal that the limits of the devices allow."""
    bounds = ({"N": limit.force_n, "N m": limit.torque_n_m}.get(unit) for limit in rig.limits.values())
    return max((bound for bound in bounds if bound is not None), default=math.inf)


def _difference(signals: Sequence[FloatArray], plain: Sequence[FloatArray]) -> list[FloatArray]:
    return [ours - theirs for ours, theirs in zip(signals, plain, strict=True)]


def _later(conditions: Sequence[FloatArray], samples: FloatArray) -> list[FloatArray]:
    """Return the signals of each condition shifted by so many samples, held at their ends."""
    later = []
    for signals, by in zip(conditions, samples, strict=True):
        count = np.arange(len(signals))
        later.append(np.column_stack([np.interp(count - by, count, column) for column in signals.T]))
    return later


def _left(white: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return the part orthogonal to the columns."""
    remainder: FloatArray = white - slopes @ np.linalg.lstsq(slopes, white, rcond=1e-8)[0]
    return remainder


def _follow(rig: Rig, motion: Trajectory) -> None:
    for actuator in rig.actuators.values():
        joints = tuple(joint for joint in actuator.joints if joint in motion.joints)
        if joints:
            actuator.follow(motion.only(joints), rig.clock.now())
