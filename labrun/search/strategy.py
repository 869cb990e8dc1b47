"""One CMA-ES by pycma in variables scaled to [0, 1], with the constants of Hansen's tutorial."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Constants:
    """Strategy constants of CMA-ES.

    Hansen, "The CMA Evolution Strategy: A Tutorial" (arXiv:1604.00772), table 1, with the rank-mu numerator
    ``mu_eff - 2 + 1/mu_eff`` of its first edition. With population 60, parents 30 and n = 6 these are the numbers of
    Table 6.1 of the source work: mu_eff 16.57, d_sigma 2.66, c_mu 0.36, and c_sigma 0.67 (printed there as the
    initial step size). pycma 4.5 by itself would cap c_sigma at 0.5 (so d_sigma 2.81) and take c_mu = 0.37.
    """

    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float

    @classmethod
    def of(cls, n: int, population: int, mu_eff: float) -> "Constants":
        """Return the constants for `n` variables and variance-effective selection mass `mu_eff`."""
        c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
        c_1 = min(1.0, population / 6) * 2 / ((n + 1.3) ** 2 + mu_eff)
        return cls(
            mu_eff=mu_eff,
            c_sigma=c_sigma,
            d_sigma=1 + 2 * max(0.0, math.sqrt(max(mu_eff - 1, 0.0) / (n + 1)) - 1) + c_sigma,
            c_c=(4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n),
            c_1=c_1,
            c_mu=min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / ((n + 2) ** 2 + mu_eff)),
        )


class Strategy:
    """Ask-and-tell interface of an optimiser on the unit cube.

    Parameters
    ----------
    start : (n,)
        Where the search starts, each variable scaled to [0, 1].
    step_size
        Initial standard deviation, as a share of each range.
    population, parents
        None: pycma's defaults (4 + 3 ln n, and half of it).
    rng
        The only source of randomness.
    """

    def __init__(
        self,
        start: FloatArray,
        step_size: float,
        population: int | None,
        parents: int | None,
        rng: np.random.Generator,
    ) -> None:
        import cma

        n = len(start)
        options: dict[str, Any] = {
            "bounds": [[0.0] * n, [1.0] * n],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": math.nan,  # pycma seeds nothing: the generator is ours
            "verbose": -10,
            "verb_log": 0,
            "maxiter": math.inf,
        }
        if population is not None:
            options["popsize"] = population
        if parents is not None:
            options["CMA_mu"] = parents
        with warnings.catch_warnings():
            # about its own option strings, and one-dimensional searches
            warnings.simplefilter("ignore", UserWarning)
            probe = cma.CMAEvolutionStrategy(start.tolist(), step_size, options)
            wanted = Constants.of(n, int(probe.popsize), float(probe.sp.weights.mueff))
            # pycma multiplies its own c_mu by this option wherever it uses it.
            options["CMA_rankmu"] = wanted.c_mu / float(probe.sp.cmu)
            self._es = cma.CMAEvolutionStrategy(start.tolist(), step_size, options)
        self._es.adapt_sigma.initialize(self._es)
        self._es.adapt_sigma.cs = wanted.c_sigma
        self._es.adapt_sigma.damps = wanted.d_sigma
        self._es.sp.cc = wanted.c_c
        self._cost_unit: float | None = None

    @property
    def population(self) -> int:
        """Number of points of a generation."""
        return int(self._es.popsize)

    @property
    def constants(self) -> Constants:
        """The constants in force, read back from pycma's own objects."""
        es = self._es
        sampler = es.sm.parameters(mueff=es.sp.weights.mueff, lam=es.sp.weights.lambda_)
        return Constants(
            mu_eff=float(es.sp.weights.mueff),
            c_sigma=float(es.adapt_sigma.cs),
            d_sigma=float(es.adapt_sigma.damps),
            c_c=float(es.sp.cc),
            c_1=float(es.opts["CMA_rankone"] * sampler["c1"]),
            c_mu=float(es.opts["CMA_rankmu"] * sampler["cmu"]),
        )

    @property
    def mean(self) -> FloatArray:
        """Mean of the distribution, inside the unit cube, shape (n,)."""
        return np.asarray(self._es.boundary_handler.repair(self._es.gp.pheno(self._es.mean)), dtype=float)

    @property
    def largest_spread(self) -> float:
        """Largest standard deviation of any variable, as a share of its range."""
        return float(self._es.sigma * np.sqrt(np.diag(self._es.sm.covariance_matrix).max()))

    def ask(self, number: int) -> list[FloatArray]:
        """Draw points of the unit cube."""
        return [np.asarray(point, dtype=float) for point in self._es.ask(number)] if number else []

    def tell(self, points: Sequence[FloatArray], costs: Sequence[float], *, known: int = 0) -> None:
        """Learn from a generation: the lower the cost, the better.

        `points`, `costs`: as many as the population. `known`: the first so many points were not drawn in this
        generation. Their distance from the mean is clipped, so that they cannot blow up the step size (Hansen 2011,
        arXiv:1110.4181).
        """
        # pycma compares the spread of costs with absolute tolerances (tolfun 1e-11, tolfunhist 1e-12): in units of the
        # first generation's spread they mean the same for newtons and for nanonewtons
        if self._cost_unit is None:
            self._cost_unit = float(np.ptp(costs)) or 1.0
        costs = [cost / self._cost_unit for cost in costs]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            self._es.tell(list(points), costs, check_points=list(range(known)) or None)

    def exhausted(self) -> str | None:
        """Return why this strategy has nothing left to gain numerically; None while it has."""
        reasons = [str(reason) for reason in self._es.stop()]
        return ", ".join(sorted(reasons)) or None

    def state(self) -> dict[str, Any]:
        """Return the distribution and its paths, JSON-ready, exact to the last bit."""
        es = self._es
        return {
            "generation_of_restart": int(es.countiter),
            "mean": es.mean.tolist(),
            "sigma": float(es.sigma),
            "covariance": es.sm.covariance_matrix.tolist(),
            "path_sigma": np.asarray(es.adapt_sigma.ps).tolist(),
            "path_c": np.asarray(es.pc).tolist(),
        }
