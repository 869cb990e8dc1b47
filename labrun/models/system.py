"""What the kernels integrate: a model with its laws, as numbers and pointers."""

from typing import NamedTuple

from labrun.compiled import IntPointer, Pointer


class System(NamedTuple):
    """A model with the laws at its sites.

    The functions called through these addresses take pointers anyway; with pointers throughout, no array is handed
    from function to function, at each of which numba would count a reference to it.

    Attributes
    ----------
    derivative, site_values
        Addresses; `site_values` is 0 where every site is read from states and parameters (see `Forces.sites`).
    total
        States, those of the laws included.
    coupled
        Whether a law depends on acceleration.
    site_table : (5 * sites,), law_table : (5 * laws,)
        Rows of `Forces.sites` and `Forces.laws`.
    p, values
        Values of the model and of the laws.
    force : (sites,)
    site : (4 * sites,)
        Coordinate, rate, load and stiffness of each site.
    scratch
        For `couple`: see `labrun.models.layout.scratch_size`.
    """

    derivative: int
    site_values: int
    total: int
    sites: int
    laws: int
    coupled: bool
    site_table: IntPointer
    law_table: IntPointer
    p: Pointer
    values: Pointer
    force: Pointer
    site: Pointer
    scratch: Pointer
