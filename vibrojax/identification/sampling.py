"""Samples of the posterior, with blackjax.

Following a curve is dear and goes many lanes at a time, so proposals are drawn and evaluated
before the chain runs: independent ones, from a Student distribution about the minimum.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from vibrojax._tools.checks import check_count, check_seed
from vibrojax.identification.fit import Fit
from vibrojax.identification.posterior import Posterior

HEAVINESS = 5
"""Degrees of freedom of the proposals: tails heavier than the posterior's."""
WIDER = 1.2
BATCH = 32


def sample(fit: Fit, draws: int, *, evaluations: int = 256, seed: int = 0) -> Posterior:
    """See `Identification.sample`."""
    check_count("draws", draws, least=10)
    check_count("evaluations", evaluations, least=16)
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
    student = stats.multivariate_t(fit.point, spread, df=HEAVINESS, seed=seed)
    points = np.reshape(student.rvs(evaluations), (evaluations, -1))
    points = points[np.all((points >= low) & (points <= high), axis=1)]
    proposal = np.atleast_1d(student.logpdf(points))
    excess = max(1.0, fit.reduced_chi_square)
    cost = np.concatenate(
        [_costs(fit, points[i : i + BATCH]) for i in range(0, len(points), BATCH)]
    )
    target = -(cost - fit.chi_square) / 2 / excess
    for k, c in enumerate(fit.problem.coordinates):
        if c.kind == "asinh":  # a uniform prior in the number, as its interval has it
            target = target + np.log(c.slope(points[:, k]))
    table = {
        "point": jnp.asarray(points),
        "target": jnp.asarray(target),
        "proposal": jnp.asarray(proposal),
    }

    def propose(key):
        index = jax.random.randint(key, (), 0, len(points))
        return jax.tree.map(lambda a: a[index], table)

    chain: Any = blackjax.irmh(
        lambda at: at["target"], propose, lambda start, end: end.position["proposal"]
    )
    keys = jax.random.split(jax.random.key(seed), draws)
    best = jax.tree.map(lambda a: a[jnp.argmax(jnp.asarray(target))], table)

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


def _costs(fit: Fit, points: np.ndarray) -> np.ndarray:
    which = np.full(len(points), fit.repetition)
    residual, _ = fit.problem.evaluate(points, which, fit.frequency_scale)
    return np.sum(residual**2, axis=1)
