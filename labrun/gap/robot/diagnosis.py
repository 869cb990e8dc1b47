"""What was found about a robot: of every joint, and of the robot as a whole."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.effects import AttachedEffect
from labrun.gap import criteria
from labrun.gap.diagnosis import Cause, Diagnosis, Verdict, cause_json
from labrun.models import RobotJoint

OfTheWhole = tuple[str, tuple[str, ...], Mapping[str, float]]
"""An effect of the whole robot, the joints that tell it, and its values."""
OF_THE_WHOLE = ("gravity-tilt", "gravity-compensation", "payload")
"""Effects that one joint shows and the whole robot has."""
OF_THE_LOG = ("late-clock", "delay")
"""Of all goals at once: stamped late beside all angles, or followed late by them."""


@dataclass(frozen=True)
class JointDiagnosis:
    """What was found about one joint.

    Attributes
    ----------
    stated, recalibrated, corrected
        Root mean square of measured minus simulated of this joint, in its unit, where the whole robot is simulated:
        with the model as stated, with parameters recalibrated, with all causes of all joints added. NaN where the
        simulation leaves the finite numbers.
    agreed
        Its parameters as the median of what all joints say: a mass moves every joint that carries it.
    error_unit
        Of `stated`, `recalibrated` and `corrected` where they are not in the joint's unit: torques that a log holds.
    """

    joint: RobotJoint
    diagnosis: Diagnosis
    stated: float
    recalibrated: float
    corrected: float
    agreed: Mapping[str, float] = field(default_factory=dict)
    error_unit: str = ""

    @property
    def moved(self) -> dict[str, float]:
        """Parameters that explain the joint by being far from what is stated, by the factor they are off; else none.

        None of a joint that moves as stated to within one trial's noise: gain, damping and mass trade for one another.
        """
        if self.diagnosis.causes or self.diagnosis.verdict == "unexplained" or self.diagnosis.gap.raw <= 1.0:
            return {}
        return {
            name.removesuffix("_ratio"): estimate / stated
            for name, (stated, tolerance, estimate) in self.diagnosis.recalibration.items()
            if isinstance(tolerance, float)
            and stated
            and 0
            < criteria.FAR_MOVED * tolerance
            <= min(abs(value / stated - 1.0) for value in (estimate, self.agreed.get(name, estimate)))
        }


@dataclass(frozen=True)
class RobotDiagnosis:
    """What was found about a robot.

    Attributes
    ----------
    whole
        Causes of the robot as a whole (a tilted base, a load, a clock of all goals), with the joints that show each.
    effects, values
        All causes as they go into the model of the whole robot, and its parameters.
    remarks
        What to know, in sentences.
    headline
        What comes before the joints in the answer: a load, a missing hand, the unit of logged torques.
    whole_causes
        Causes of the robot as a whole that no single joint tells.
    input_factors
        What logged inputs are multiplied by to be the model's: motor currents become torques. 1 where not named.
    """

    name: str
    model: str
    source: str
    joints: tuple[JointDiagnosis, ...]
    whole: tuple[OfTheWhole, ...]
    effects: tuple[AttachedEffect, ...]
    values: Mapping[str, float]
    remarks: tuple[str, ...]
    seconds: float
    headline: tuple[str, ...] = ()
    whole_causes: tuple[Cause, ...] = ()
    input_factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def named(self) -> tuple[JointDiagnosis, ...]:
        """The joints at which a cause was found."""
        return tuple(joint for joint in self.joints if joint.diagnosis.causes)

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of a joint that lacks something; "no-gap" where none does."""
        verdicts = {joint.diagnosis.verdict for joint in self.joints}
        order: tuple[Verdict, ...] = ("unexplained", "partly-explained", "mostly-explained", "explained")
        if not self.named and (self.whole or self.headline):
            return "explained"
        return next((verdict for verdict in order if verdict in verdicts), "no-gap")

    @property
    def clock(self) -> str:
        """What the goals of all joints have in time beside the angles; "" if nothing."""
        return next((name for name, _, _ in self.whole if name in OF_THE_LOG), "")

    @property
    def sentence(self) -> str:
        """The answer, as a sentence."""
        texts = [
            f"{named_cause.joint.name}: "
            f"{' and '.join(cause.name.words.partition(' at ')[0] for cause in named_cause.diagnosis.causes)}"
            for named_cause in self.named
        ]
        unexplained = [joint.joint.name for joint in self.joints if joint.diagnosis.verdict == "unexplained"]
        texts += [_clock_words(name, values) for name, _, values in self.whole if name in OF_THE_LOG]
        message = "; ".join(texts) if texts else "nothing but recalibration is asked for at any joint"
        far = [f"{name} {100 * (by - 1):+.2g} %" for joint in self.joints for name, by in joint.moved.items()]
        if far and not texts:
            message = f"parameters are far from what is stated: {', '.join(far)}"
        several = self.named and len(self.joints) > 1
        count = f"{len(self.named)} of {len(self.joints)} joints lack physics: " if several else ""
        rest = f"; unexplained: {', '.join(unexplained)}" if unexplained else ""
        rest += f"; far from what is stated: {', '.join(far)}" if far and texts else ""
        if self.headline and not texts:
            return f"{'; '.join(self.headline)}{rest}."
        first = "".join(f"{sentence}; " for sentence in self.headline)
        return f"{first}{count}{message}{rest}."

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints, with what makes the corrected model."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "name": self.name,
            "model": self.model,
            "source": self.source,
            "joints": [
                {
                    "joint": joint.joint.name, "unit": joint.joint.unit, "stated": _number(joint.stated),
                    "recalibrated": _number(joint.recalibrated), "corrected": _number(joint.corrected),
                    **({"error_unit": joint.error_unit} if joint.error_unit else {}),
                    "moved": joint.moved, "diagnosis": joint.diagnosis.to_json(),
                }
                for joint in self.joints
            ],
            "whole": [
                {"effect": name, "joints": list(joints), "values": dict(values)}
                for name, joints, values in self.whole
            ],
            "corrected": dict(self.values),
            **({"input_factors": dict(self.input_factors)} if self.input_factors else {}),
            "effects": [
                {
                    "effect": effect.effect.id, "kind": effect.effect.kind,
                    "site": effect.site, "values": list(effect.values),
                }
                for effect in self.effects
            ],
            "notes": list(self.remarks),
            "data": {
                "trials": self.joints[0].diagnosis.trials,
                "conditions": self.joints[0].diagnosis.conditions,
                "repeats": self.joints[0].diagnosis.repeats,
            },
            "seed": self.joints[0].diagnosis.seed,
            "limitations": [],
            "causes": [
                *(cause_json(cause) for cause in self.whole_causes),
                *(cause for joint in self.joints for cause in joint.diagnosis.to_json()["causes"]),
            ],
            "seconds": round(self.seconds, 2),
        }  # fmt: skip


def _clock_words(effect: str, values: Mapping[str, float]) -> str:
    (time_s,) = values.values()
    if effect == "delay":
        return f"all joints: goals are followed {1e3 * time_s:.3g} ms late"
    return f"the log: goals are stamped {1e3 * time_s:.3g} ms late beside all angles"


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
