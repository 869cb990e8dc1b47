"""What happens at the sites of a model during a trial: coordinate, rate, load and stiffness."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.models.model import Condition, Model


def site_course(
    model: Model,
    time_s: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    *,
    parameters: FloatArray | None = None,
    condition: Condition | None = None,
) -> FloatArray:
    """Return what every joint and body site sees at the samples of a simulated trial.

    Parameters
    ----------
    states : (samples, states)
        Of `Simulation.states`.
    inputs : (samples, inputs)

    Returns
    -------
    (samples, sites, 4)
        Coordinate, rate, load and stiffness (0 where a site declares none), SI, in the order of `Model.sites`.
    """
    from labrun.models.site_loop import evaluate

    found = np.zeros((len(time_s), 4 * len(model.sites)))
    if model.sites:
        p = model.vector(parameters, condition or {})
        force = np.zeros(len(model.sites))
        evaluate(
            model.site_values.address,
            np.ascontiguousarray(time_s, dtype=float),
            np.ascontiguousarray(states, dtype=float),
            np.ascontiguousarray(inputs, dtype=float),
            p,
            force,
            found,
        )
    return found.reshape(len(time_s), len(model.sites), 4)
