"""The posterior of an identification, sampled with blackjax.

Following a curve is dear and goes many lanes at a time, so proposals are drawn and evaluated
before the chain runs: independent ones, from a Student distribution about the minimum.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from vibrojax._tools.checks import check_count, check_seed
from vibrojax.identification.fit import Fit
from vibrojax.identification.trail import Trail

if TYPE_CHECKING:
    import xarray

HEAVINESS = 5
"""Degrees of freedom of the proposals: tails heavier than the posterior's."""
WIDER = 1.2
EVALUATIONS, BATCH = 256, 32


@dataclass(frozen=True, repr=False)
class Posterior:
    """Draws of the numbers; arrays of shape (draws,)."""

    draws: dict[str, np.ndarray]
    acceptance: float
    """Share of proposals that were accepted; near 1 where the posterior is nearly normal."""
    effective_size: float
    """How many independent draws the evaluations are worth."""
    evaluations: int
    confidence: float

    @property
    def interval(self) -> dict[str, tuple[float, float]]:
        """Central intervals of the draws."""
        tail = (1 - self.confidence) / 2
        return {
            n: (float(np.quantile(v, tail)), float(np.quantile(v, 1 - tail)))
            for n, v in self.draws.items()
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `draw`."""
        import xarray

        about = {"long_name": "Draw of the posterior", "units": "SI, as the rig's argument"}
        return xarray.Dataset(
            {n: ("draw", v, about) for n, v in self.draws.items()},
            attrs={"acceptance": self.acceptance, "effective_size": self.effective_size},
        )

    def __repr__(self) -> str:
        lines = [
            f"Posterior({len(next(iter(self.draws.values())))} draws from {self.evaluations} "
            f"evaluations, worth {self.effective_size:.0f} independent ones)"
        ]
        for n, v in self.draws.items():
            low, high = self.interval[n]
            lines.append(
                f"  {n}  mean {v.mean():.5g}, {100 * self.confidence:g} % within {low:.5g} to "
                f"{high:.5g}"
            )
        return "\n".join(lines)


def sample(fit: Fit, draws: int, *, seed: int = 0) -> Posterior:
    """See `Identification.sample`."""
    check_count("draws", draws, least=10)
    check_seed(seed)
    try:
        import blackjax  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(
            'Sampling needs blackjax, which is optional: pip install "vibrojax[sample]".'
        ) from None
    if not np.isfinite(fit.covariance).all():
        raise ValueError(
            "The data do not know all of the numbers, so there is no scale to sample on: "
            f"{'; '.join(f'{n}: {s}' for n, s in fit.identifiability.items())}."
        )
    low, high = fit.problem.limits
    spread: Any = WIDER * fit.covariance
    student = scipy.stats.multivariate_t(fit.point, spread, df=HEAVINESS, seed=seed)
    points = np.reshape(student.rvs(EVALUATIONS), (EVALUATIONS, -1))
    points = points[np.all((points >= low) & (points <= high), axis=1)]
    proposal = np.atleast_1d(student.logpdf(points))
    excess = max(1.0, fit.reduced_chi_square)
    # All go on from the minimum, the first of them.
    cost, trail = np.zeros(0), Trail()
    for some in (fit.point[None], *np.split(points, range(BATCH, len(points), BATCH))):
        which, one = np.full(len(some), fit.repetition), np.zeros(len(some), int)
        residual, _ = fit.problem.evaluate(
            some, which, fit.frequency_scale, trail=trail, starts=one
        )
        cost = np.append(cost, np.sum(residual**2, axis=1))
    cost = cost[1:]
    target = -(cost - fit.chi_square) / 2 / excess
    for k, c in enumerate(fit.problem.coordinates):
        if c.kind == "asinh":  # a uniform prior in the number, as its interval has it
            target = target + np.log(c.slope(points[:, k]))
    table = jax.tree.map(jnp.asarray, {"point": points, "target": target, "proposal": proposal})

    def propose(key):
        index = jax.random.randint(key, (), 0, len(points))
        return jax.tree.map(lambda a: a[index], table)

    chain: Any = blackjax.irmh(
        lambda at: at["target"], propose, lambda start, end: end.position["proposal"]
    )
    keys = jax.random.split(jax.random.key(seed), draws)
    best = jax.tree.map(lambda a: a[np.argmax(target)], table)

    def step(state, key):
        state, info = chain.step(key, state)
        return state, (state.position["point"], info.is_accepted)

    _, (chosen, accepted) = jax.lax.scan(step, chain.init(best), keys)
    numbers = fit.problem.numbers(np.asarray(chosen))
    weight = np.exp(target - proposal - np.max(target - proposal))
    return Posterior(
        draws={n: numbers[:, k] for k, n in enumerate(fit.names)},
        acceptance=float(jnp.mean(accepted)),
        effective_size=float(weight.sum() ** 2 / np.sum(weight**2)),
        evaluations=len(points),
        confidence=fit.confidence,
    )
