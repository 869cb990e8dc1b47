"""Compiled: the derivative of a model with force laws at its sites. Importing this imports numba."""

from labrun.compiled import Pointer, inlined
from labrun.models.calling import beyond, call_law, call_model, few
from labrun.models.coupling import couple
from labrun.models.system import System


@inlined
def load(t: float, state: Pointer, u: Pointer, slope: Pointer, system: System) -> None:
    """Write `site`, and to `force` what the laws that do not depend on acceleration give.

    The derivatives of those laws' own states are written to `slope`. Arguments as in `slopes`.
    """
    force, site = system.force, system.site
    if system.site_values != 0:
        for at in range(system.sites):
            few()
            force[at] = 0.0
        call_model(system.site_values, t, state, u, system.p, force, site)
    else:
        for at in range(system.sites):
            few()
            row = beyond(system.site_table, 5 * at)
            site[4 * at] = state[row[0]]
            site[4 * at + 1] = state[row[1]]
            site[4 * at + 3] = system.p[row[2]] if row[2] >= 0 else 0.0
    for at in range(system.sites):
        few()
        here = beyond(site, 4 * at)
        coordinate, rate, carried, stiffness = here[0], here[1], here[2], here[3]
        total = 0.0
        for e in range(system.site_table[5 * at + 3], system.site_table[5 * at + 4]):
            few()
            law = beyond(system.law_table, 5 * e)
            if law[2] == 0:
                total += call_law(
                    law[0], t, coordinate, rate, 0.0, carried, stiffness,
                    beyond(system.values, law[3]), beyond(state, law[4]), beyond(slope, law[4]),
                )  # fmt: skip
        force[at] = total


@inlined
def slopes(t: float, state: Pointer, u: Pointer, slope: Pointer, system: System, loaded: bool) -> None:
    """Write the forces at the sites to `force` and the derivative of all states to `slope`.

    Parameters
    ----------
    state, slope : (model states + effect states,)
    u : (inputs,)
    loaded
        Whether `force` is right already (and `slope`, where a law depends on acceleration).
    """
    if not loaded and system.laws > 0:
        load(t, state, u, slope, system)
    if not system.coupled:
        call_model(system.derivative, t, state, u, system.p, system.force, slope)
    elif not loaded:
        couple(t, state, u, slope, system)
