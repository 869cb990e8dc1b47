"""Which correction of each joint predicts unseen parts of the log better than what is stated, by the rule."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.errors import LabrunError
from labrun.gap import decide
from labrun.gap.robot.log_pieces import Pieces, Simulator
from labrun.gap.robot.together import parameters_of_robot
from labrun.gap.robot.withheld_fits import Correction
from labrun.gap.saving import effects_of
from labrun.models import Model

_ERROR_AS_LARGE_AS_NOISE = 2.0
"""Mean squared error, in units of the noise floor, at which the systematic error is as large as one trial's noise.

Both add up. Below it gain, damping and mass trade for one another, and any of them would follow the noise.
"""


@dataclass(frozen=True)
class Written:
    """What of a correction is better than what is stated: parameters of the whole robot, and effects."""

    values: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]

    @property
    def of_the_whole(self) -> tuple[str, ...]:
        """What the robot as a whole has: a tilted base, a load, gravity compensation."""
        words = {
            "base_roll": "a tilted base", "base_pitch": "a tilted base", "tip_load": "a load",
            "gravity_compensation": "gravity compensation",
        }  # fmt: skip
        return tuple(dict.fromkeys(words[name] for name in words if name in self.values))

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> "Written":
        """Return what `to_json` gave."""
        return cls(stored["corrected"], effects_of(stored))

    def to_json(self) -> dict[str, Any]:
        """Return the keys ``corrected`` and ``effects`` of a diagnosis."""
        effects = [
            {
                "effect": each.effect.id,
                "kind": each.effect.kind,
                "site": each.site,
                "values": list(each.values),
            }
            for each in self.effects
        ]
        return {"corrected": dict(self.values), "effects": effects}


@dataclass(frozen=True)
class Choice:
    """The correction that each joint has, and what it leaves.

    Attributes
    ----------
    levels : per joint
        Place of the correction among those of the joint; 0 is as stated.
    written
        What goes into a file, fitted to the whole log.
    errors
        Squared errors (n, joints) of every piece, by fits that have not seen it.
    score
        Mean log error of all joints.
    """

    levels: tuple[int, ...]
    written: Written
    errors: list[FloatArray]
    score: float


@dataclass(frozen=True)
class CorrectionChoice:
    """The corrections of all joints in the whole robot.

    Attributes
    ----------
    fitted : joint -> correction -> fold
    whole
        What the robot as a whole has.
    """

    model: Model
    pieces: Pieces
    fitted: Sequence[Sequence[Sequence[Correction]]]
    whole: Written
    simulator: Simulator

    def best(self) -> Choice:
        """Return the corrections that are better by the rule than what is stated."""
        nothing = Written({}, ())
        stated = self._errors((0,) * len(self.fitted), nothing)
        without = self._chosen(nothing, stated)
        if not (self.whole.values or self.whole.effects):
            return without
        within = self._chosen(self.whole, stated)
        return within if within.score < without.score else without

    def _chosen(self, whole: Written, stated: list[FloatArray]) -> Choice:
        before, strata = self.pieces.log_errors(stated), self.pieces.strata
        count = len(self.fitted)
        levels = max(len(corrections) for corrections in self.fitted)
        tables = [
            self.pieces.log_errors(
                self._errors(tuple(min(level, len(each) - 1) for each in self.fitted), whole)
            )
            for level in range(levels)
        ]
        choice = [0] * count
        moves_as_stated = (
            np.mean(np.concatenate(stated), axis=0) <= _ERROR_AS_LARGE_AS_NOISE * self.pieces.floor
        )
        for index, corrections in enumerate(self.fitted):
            if moves_as_stated[index]:
                continue
            rows = [
                level
                for level in range(1, len(corrections))
                if decide.beats(tables[level][index], before[index], strata)
                and decide.beats(tables[level][index], tables[0][index], strata)
            ]
            if rows:
                sizes = [(corrections[row][-1].size, row) for row in rows]
                table = np.array([tables[row][index] for row in rows])
                choice[index] = rows[decide.leader(table, sizes, strata)]
        choice, errors = self._simplified(choice, whole)
        while True:
            after = self.pieces.log_errors(errors)
            gains = [decide.compare(before[index], after[index], strata) for index in range(count)]
            worse = [index for index in range(count) if decide.beats(before[index], after[index], strata)]
            dropped = [index for index in range(count) if choice[index] and not gains[index].is_better]
            kept = [index for index in range(count) if choice[index] and index not in dropped]
            if not dropped and worse and kept:
                dropped = [min(kept, key=lambda index: gains[index].mean)]
            if not dropped:
                break
            choice = [0 if index in dropped else level for index, level in enumerate(choice)]
            errors = self._errors(tuple(choice), whole)
        useless = worse or not any(gain.is_better for gain in gains)
        score = np.inf if useless and (whole.values or whole.effects) else float(np.mean(after))
        return Choice(tuple(choice), self._written(tuple(choice), whole, -1), errors, score)

    def _simplified(self, choice: list[int], whole: Written) -> tuple[list[int], list[FloatArray]]:
        """Return the corrections without those that another joint's correction makes needless, and the errors left."""
        strata, errors = self.pieces.strata, self._errors(tuple(choice), whole)
        for index in range(len(choice)):
            for level in range(choice[index]):
                simpler = [*choice[:index], level, *choice[index + 1 :]]
                without = self._errors(tuple(simpler), whole)
                now, then = (self.pieces.log_errors(each)[index] for each in (errors, without))
                if not decide.beats(now, then, strata):
                    choice, errors = simpler, without
                    break
        return choice, errors

    def _errors(self, choice: tuple[int, ...], whole: Written) -> list[FloatArray]:
        models = []
        for number in range(self.pieces.folds):
            written = self._written(choice, whole, number)
            models.append(self.model.with_values(written.values).with_effects(written.effects))
        return self.pieces.errors(self.simulator, models)

    def _written(self, choice: tuple[int, ...], whole: Written, fold: int) -> Written:
        """Return parameters and effects of the whole robot."""
        chosen = [self.fitted[index][level][fold] for index, level in enumerate(choice)]
        effects: list[AttachedEffect] = list(whole.effects)
        for correction in chosen:
            for effect in correction.effects:
                try:
                    effect.check(self.model)
                except LabrunError:
                    continue  # of one joint's own equation: the whole robot has no such site
                effects.append(effect)
        values = parameters_of_robot(self.model, [correction.values for correction in chosen])
        return Written(values | dict(whole.values), tuple(effects))
