"""What the numbers in a continuation's call mean: the range to follow, axes, fixed ones."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Var

from vibrojax._tools.checks import check_positive
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import in_short
from vibrojax.ensemble.arguments import Arguments, arguments_of, numbers_apart
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.ensemble.lanes import check_lists, check_no_numbers, made_by, stacked
from vibrojax.ensemble.ranges import Range
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.systems import AbstractSystem, as_arrays, equation_kinds
from vibrojax.steady.methods import check_balance
from vibrojax.steady.paths import AbstractPath, FunctionPath, NumberPath, frequency_path


class Along(NamedTuple):
    """The parameter that is followed and everything that stays."""

    make: Any
    """The function, or the system itself."""
    name: str
    range: Range
    axes: dict[str, np.ndarray]
    fixed: dict[str, float]
    static: dict[str, Any]
    labels: list[dict[str, float]]
    """Values of the axes, by lane."""
    frequency: float
    """Drive frequency where another number is followed."""
    is_ratio: bool
    rigs: list[AbstractSystem]
    """By lane, from concrete numbers; at the low end where another number is followed."""
    far_rigs: list[AbstractSystem]
    """The same at its high end; none where the frequency is followed."""
    sample: AbstractSystem

    def paths(self, exact: bool) -> AbstractPath:
        """Make the stacked paths of all lanes."""
        if self.name in ("frequency_ratio", "frequency"):
            return frequency_paths(stacked(self.rigs), self.is_ratio, exact)
        count = len(self.labels)
        frequency = jnp.full(count, self.frequency)
        followed = _numbers_followed(self)
        if followed is not None:
            path = NumberPath(stacked(self.rigs), followed, frequency, self.is_ratio)
            # A function that decides by the numbers of a lane could have escaped.
            high = jnp.full(count, self.range.high)
            if eqx.tree_equal(path.with_number(high), stacked(self.far_rigs)):
                return path
        rows = {n: jnp.asarray([labels[n] for labels in self.labels]) for n in self.labels[0]}
        fixed = {n: jnp.full(count, v, float) for n, v in self.fixed.items()}
        return FunctionPath(
            make=self.make,
            name=self.name,
            fixed=rows | fixed,
            static=self.static,
            frequency=frequency,
            is_ratio=self.is_ratio,
        )


def _numbers_followed(along: Along) -> tuple[bool, ...] | None:
    """Which numbers of the system are the one that is followed; None if one is computed from it.

    Where none is, the programs need not know the user's function: they are the same for all.
    """
    held = along.static | along.fixed | along.labels[0]

    def leaves(value: Any) -> list[Any]:
        return jax.tree.leaves(as_arrays(along.make(**held, **{along.name: value})))

    program = jax.make_jaxpr(leaves)(jnp.asarray(along.range.low, float)).jaxpr
    (number,) = program.invars
    touched = {number}
    for equation in program.eqns:
        if any(isinstance(v, Var) and v in touched for v in equation.invars):
            touched.update(equation.outvars)
    if any(isinstance(v, Var) and v in touched and v is not number for v in program.outvars):
        return None
    return tuple(v is number for v in program.outvars)


@compiled(lightly=True)
def frequency_paths(systems: AbstractSystem, is_ratio: bool, exact: bool) -> AbstractPath:
    """Make the paths along the frequency of stacked systems."""
    return jax.vmap(lambda s: frequency_path(s, is_ratio, exact))(systems)


def frequency_of(ratio: Any, frequency: Any) -> tuple[str, Any]:
    """Return the name and the value of the one that is given. Raises `ValueError` for no other."""
    if (ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    name, value = ("frequency_ratio", ratio) if ratio is not None else ("frequency", frequency)
    if not isinstance(value, Range) and np.ndim(value) > 0:
        raise ValueError(
            f"{name} must be a range, vj.Range(low, high), or one number, got {in_short(value)}. "
            "Give the range, then branch.resample(values)."
        )
    least = value.low if isinstance(value, Range) else value
    check_positive(name, least, "(ratio)" if name == "frequency_ratio" else "Hz")
    return name, value


def along_of(
    system: AbstractSystem | Callable[..., AbstractSystem],
    frequency_ratio: Any,
    frequency: Any,
    numbers: dict[str, Any],
    groups: tuple[Any, ...] = (),
) -> Along:
    """Sort the numbers of a call. Raises `ValueError` as `continue_response` says."""
    name, value = frequency_of(frequency_ratio, frequency)
    follows_frequency = isinstance(value, Range)
    ranges = {n: v for n, v in numbers.items() if isinstance(v, Range)}
    if follows_frequency == bool(ranges) or len(ranges) > 1:
        raise ValueError(
            f"Give exactly one vj.Range(low, high) to follow: {name} or one argument of the "
            f"function. Got {1 if follows_frequency else 0} for {name} and {len(ranges)} among "
            f"the numbers of the function ({', '.join(numbers) or 'there are none'})."
        )
    if isinstance(system, AbstractSystem):
        check_no_numbers(numbers, groups)
        named = Arguments((), {}, {})
    else:
        check_lists(numbers)
        named = arguments_of(system, groups, numbers, with_ranges=True)
    for dimension in named.dimensions:
        if dimension.is_text:
            raise ValueError(
                f"{dimension.name} must be numbers, got texts among them: a branch per text is a "
                "call of its own."
            )
    fixed, static = numbers_apart(named.fixed)
    varied = [n for d in named.dimensions for n in d.values]
    labels = [{n: float(named.at(k)[n]) for n in varied} for k in np.ndindex(*named.shape)]
    if follows_frequency:
        followed, reach = name, value
        held, far = {}, []
        frequency_value = np.nan
    else:
        ((followed, reach),) = ranges.items()
        frequency_value = float(value)
        # Both ends are built from concrete numbers, so checked.
        held = {followed: reach.low}
        far = [_make(system, static | fixed | row | {followed: reach.high}) for row in labels]
    rigs = [_make(system, static | fixed | row | held) for row in labels]
    sample = rigs[0] if follows_frequency else rigs[-1]
    check_continued(sample)
    return Along(
        make=system,
        name=followed,
        range=reach,
        axes=named.axes,
        fixed=fixed,
        static=static,
        labels=labels,
        frequency=frequency_value,
        is_ratio=name == "frequency_ratio",
        rigs=rigs,
        far_rigs=far,
        sample=sample,
    )


def _make(system: Any, numbers: dict[str, Any]) -> AbstractSystem:
    return system if isinstance(system, AbstractSystem) else made_by(system, numbers)


def check_continued(system: AbstractSystem) -> None:
    """Refuse, with a `ValueError`, a system whose branches cannot be followed."""
    check_drive(system)
    equations = equation_kinds(system)
    check_equations(system, equations)
    check_balance(equations.stops)


def check_equations(system: AbstractSystem, equations: AbstractEquations) -> None:
    """Refuse, with a `ValueError`, equations that are not linear but for stops."""
    if equations.linear_between_contacts is None:
        raise ValueError(
            f"{type(system).__name__} is not linear but for its stops, which harmonic balance "
            "needs. Use periodic_response(..., method=Shooting()) at single points."
        )
    if not equations.stops:
        raise ValueError(
            "The system has no stops, so its response is linear: one curve without branches. "
            "Use frequency_sweep."
        )
