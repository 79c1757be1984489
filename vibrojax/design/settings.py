"""Settings of searches for designs, as `optimise` and `pareto` take them."""

import equinox as eqx

from vibrojax._tools.checks import check_choice, check_count, check_range, check_seed
from vibrojax._tools.described import AbstractSettings
from vibrojax._tools.signatures import validated
from vibrojax.branches.settings import ContinuationSettings


@validated
class OptimiseSettings(AbstractSettings):
    """How a design is searched for. Raises `ValueError` for settings that cannot work."""

    starts: int = eqx.field(static=True, default=4)
    """Searches that go on side by side, from designs apart from each other."""
    screened: int = eqx.field(static=True, default=64)
    """Designs, spread evenly between the bounds, that are evaluated first; searches begin at the
    best of them."""
    max_rounds: int = eqx.field(static=True, default=60)
    """Most designs that each search may try."""
    tolerance: float = eqx.field(static=True, default=1e-7)
    """Change of the objective at which a search ends, and by how much constraints may be missed,
    over the spread of the function among the designs screened."""
    method: str = eqx.field(static=True, default="SLSQP")
    """Of `scipy.optimize.minimize`: "SLSQP" or "trust-constr"."""
    seed: int = eqx.field(static=True, default=0)
    """Of the designs screened."""
    continuation: ContinuationSettings | None = None
    """How the branch of a design is followed."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_count("starts", self.starts, most=1000)
        check_count("screened", self.screened, most=10**6)
        check_count("max_rounds", self.max_rounds)
        check_range("tolerance", self.tolerance, 1e-12, 0.1, allowed="from 1e-12 to 0.1")
        check_choice("method", self.method, ("SLSQP", "trust-constr"))
        check_seed(self.seed)
