"""The response of one rig over a range of the drive frequency, and what can be asked of it."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_range
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import is_number
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.points import TURNS
from vibrojax.design import measures
from vibrojax.design.areas import area_of
from vibrojax.design.group import Ask
from vibrojax.design.known_branch import KnownBranch, Node
from vibrojax.design.measures import Dual, NoSuchPlace, Variable, variable_of
from vibrojax.design.pieces import Knot, Piece, knots_of, node_of, pieces_of

Number = Any
"""A float, or what JAX differentiates."""
POWERS = ("mean_power", "peak_power")


@jax.custom_jvp
def _number(moved: Any, argument: Any, value: Any, slopes: Any) -> Any:
    """Return the value; its derivatives are the slopes, the last one in the argument."""
    return value


@_number.defjvp
def _number_jvp(primals: Any, tangents: Any) -> Any:
    _, _, value, slopes = primals
    moved, argument, _, _ = tangents
    return value, slopes[:-1] @ moved + slopes[-1] * argument


class Response:
    """What a rig does over a range of the drive frequency: what objectives are made of.

    Its methods return numbers with exact derivatives in the numbers of the rig: on their own they
    are plain floats, in a function given to `slopes`, `vj.optimise` or `vj.propagate` JAX
    differentiates through them. They are of stable motions, those that a sweep can settle on. A
    method raises `ValueError` where the branch has no place of the kind that it is about.

    Where the branch changes its shape as the rig changes (folds appear, a second contact begins), a
    measure is that of the branch as it is, and its derivative that of the same shape: `shape` says
    which.

    Made by `vj.design.respond`, from its `branch`, the `numbers` of the rig, its `natural`
    frequency (Hz) with derivatives, and, while JAX differentiates, by how much the numbers are
    `moved`.
    """

    branch: Branch
    """The periodic responses, stable and unstable, all points exact."""
    known: KnownBranch
    """The same, as what measures its motions."""

    def __init__(
        self,
        branch: Branch,
        known: KnownBranch,
        numbers: Mapping[str, float],
        natural: tuple[float, np.ndarray],
        moved: Any = None,
    ):
        self.branch, self.known = branch, known
        self._values, self._natural = dict(numbers), natural
        self._moved = np.zeros(len(numbers)) if moved is None else moved
        self._plain = moved is None
        self._done: dict[Any, Any] = {}

    def ask_of(self, ask: Ask) -> None:
        """Let `ask` compute what is asked from now on, together with what others ask for."""
        self.known.ask = ask

    def _with(self, moved: Any) -> "Response":
        """The same response, its numbers moved by what JAX is tracing."""
        other = Response(self.branch, self.known, self._values, self._natural, moved)
        other._done = self._done
        return other

    @validated
    def slopes(self, function: Callable[["Response"], Any]) -> tuple[float, dict[str, float]]:
        """Return the value of a function of this response, and its derivatives by number.

        `function` takes a response and returns one number, made with `jax.numpy` of what the
        methods return; NaN is a derivative that is not known. Raises `ValueError` for a function
        that returns no number or cannot be differentiated.
        """
        value, slopes = self.differentiate(function)
        return value, dict(zip(self._values, map(float, slopes), strict=True))

    def differentiate(
        self, function: Callable[["Response"], Any]
    ) -> tuple[float, Float[np.ndarray, " numbers"]]:
        """Return the value of a function of this response, and its derivatives in order.

        Raises `ValueError` as `slopes` does.
        """
        name = getattr(function, "__name__", repr(function))

        def of(moved: Any) -> Any:
            value: Any = function(self._with(moved))
            is_one = not isinstance(value, str | bytes | None) and np.shape(value) == ()
            if not is_one:
                raise ValueError(
                    f"The function {name} of a response must return one number, got "
                    f"{in_short(value)}."
                )
            return jnp.asarray(value, float)

        try:
            value, push = jax.linearize(of, jnp.zeros(len(self._values)))
        except jax.errors.JAXTypeError as error:
            raise ValueError(
                f"The function {name} cannot be differentiated: write it with jax.numpy and the "
                f"operators of numbers, without float(). ({str(error).splitlines()[0]})"
            ) from None
        slopes = jax.vmap(push)(jnp.eye(len(self._values)))
        return float(value), np.asarray(slopes)

    # ------------------------------------------------------------------------------- what it is

    @property
    def numbers(self) -> dict[str, Number]:
        """The numbers that the rig was made of, by name."""
        unit = np.eye(len(self._values) + 1)[:-1]
        return {
            name: self._give(Dual(value, unit[k]))
            for k, (name, value) in enumerate(self._values.items())
        }

    @property
    def natural_frequency(self) -> Number:
        """First natural frequency of the unstopped rig, Hz."""
        return self._give(Dual(self._natural[0], np.append(self._natural[1], 0.0)))

    @property
    def shape(self) -> str:
        """What kind of branch it is: its stable parts, folds and touches, in order along it."""
        kinds = [point.kind for point in self.branch.special_points]
        counted = [f"{len(self._stable)} stable"] + [k.replace("_", " ") for k in kinds]
        return ", ".join(counted)

    # ---------------------------------------------------------------------------------- measures

    @validated(traceable=True)
    def peak(self, variable: str = "amplitude_ratio", *, stable: bool = True) -> Number:
        """Return the largest value of a variable over the range.

        `variable` is a curve of a branch (`amplitude_ratio`, `peak_ratio`, `rms_ratio`,
        `first_harmonic_ratio`, `contact_force` in N, `contact_fraction`, and what a harvester
        reports), or `impulse`: that of all contacts in a drive period, N s. With `stable=False`
        unstable motions count too. Raises `ValueError` for an unknown variable.
        """
        return self._give(self._peak(variable, stable).height)

    @validated(traceable=True)
    def peak_frequency(self, variable: str = "amplitude_ratio") -> Number:
        """Return where a variable is largest, in the unit of the frequency axis.

        Raises `ValueError` for an unknown variable.
        """
        peak, own = self._peak(variable, True), self._variable(variable)
        key = "peak frequency", variable
        return self._give(self._once(key, lambda: measures.peak_frequency_of(peak, own)))

    @validated(traceable=True)
    def resonance_shift(self, variable: str = "amplitude_ratio") -> Number:
        """Return the frequency of the peak less the first natural one of the unstopped rig.

        In the unit of the frequency axis. Raises `ValueError` for an unknown variable.
        """
        linear = 1.0 if self.branch.axis == "frequency_ratio" else self.natural_frequency
        return self.peak_frequency(variable) - linear

    @validated(traceable=True)
    def at(self, variable: str, frequency: Number, *, of: str = "upper") -> Number:
        """Return a variable at a frequency, on the `upper` or `lower` stable part.

        `frequency` is in the unit of the frequency axis. Raises `ValueError` for an unknown
        variable, or where no stable motion is.
        """
        own, at, upper = self._variable(variable), _plain("frequency", frequency), _is_upper(of)
        key = "at", variable, at, upper
        find = lambda: measures.at_frequency(self._stable, own, at, upper)  # noqa: E731
        return self._give(self._once(key, find), frequency)

    @validated(traceable=True)
    def fold_frequency(self, number: int = -1) -> Number:
        """Return where the branch folds, in the unit of the frequency axis.

        `number` counts folds by frequency: 0 is the lowest, -1 the highest. Raises `ValueError`
        where there are not so many.
        """
        return self._give(measures.frequency_of(self._fold(number)))

    @validated(traceable=True)
    def fold_height(self, variable: str = "amplitude_ratio", number: int = -1) -> Number:
        """Return a variable at a fold.

        `number` counts folds by frequency: 0 is the lowest, -1 the highest. Raises `ValueError`
        where there are not so many, or for an unknown variable.
        """
        return self._give(self._variable(variable).of(self._fold(number)))

    @validated(traceable=True)
    def hysteresis_width(self) -> Number:
        """Return over how wide a band of the frequency two or more stable motions exist.

        0 where there is none; it grows from there without a jump.
        """
        spans = measures.covered(list(map(measures.span_of, self._stable)), least=2)
        return self._give(measures.length(spans, self.known))

    @validated(traceable=True)
    def bandwidth(
        self, level: Number, variable: str = "amplitude_ratio", *, of: str = "upper"
    ) -> Number:
        """Return over how wide a band of the frequency a variable is above a level.

        On the `upper` stable part it counts where one of the stable motions is above, on the
        `lower` where all are. Raises `ValueError` for an unknown variable.
        """
        own, at, upper = self._variable(variable), _plain("level", level), _is_upper(of)
        key = "bandwidth", variable, at, upper
        return self._give(self._once(key, lambda: self._width(own, at, upper)), level)

    def _width(self, variable: Variable, level: float, upper: bool) -> Dual:
        over = [span for p in self._stable for span in measures.above(p, variable, level)]
        if upper:
            return measures.length(measures.covered(over), self.known)
        # Where a stable motion exists that is not above does not count.
        every = list(map(measures.span_of, self._stable))
        total = measures.still(0.0, self.known)
        for least in range(1, len(every) + 1):
            both = _both(measures.covered(every, least), measures.covered(over, least))
            higher = measures.covered(every, least + 1)
            total += measures.length(both, self.known)
            total -= measures.length(_both(both, higher), self.known)
        return total

    @validated(traceable=True)
    def half_power_bandwidth(
        self, variable: str = "amplitude_ratio", *, of: str = "upper"
    ) -> Number:
        """Return the bandwidth above the peak over the root of two, of a power half of the peak.

        Raises `ValueError` for an unknown variable.
        """
        share = 0.5 if variable in POWERS else 0.5**0.5
        return self.bandwidth(share * self.peak(variable), variable, of=of)

    @validated(traceable=True)
    def area(
        self,
        variable: str = "amplitude_ratio",
        *,
        of: str = "upper",
        low: float | None = None,
        high: float | None = None,
    ) -> Number:
        """Integrate a variable over the frequency, on the `upper` or `lower` stable part.

        `low` and `high` bound the band, by default that of the range. Raises `ValueError` for an
        unknown variable, a band that is not in the range, or where no stable motion is.
        """
        a, b = self._band(low, high)
        own, upper = self._variable(variable), _is_upper(of)
        key = "area", variable, a, b, upper
        return self._give(self._once(key, lambda: area_of(self._stable, own, a, b, upper)))

    @validated(traceable=True)
    def mean(
        self,
        variable: str = "amplitude_ratio",
        *,
        of: str = "upper",
        low: float | None = None,
        high: float | None = None,
    ) -> Number:
        """Return the mean of a variable over the band; otherwise as `area`.

        `low` and `high` bound the band. Raises `ValueError` as `area` does.
        """
        a, b = self._band(low, high)
        return self.area(variable, of=of, low=low, high=high) / (b - a)

    # ------------------------------------------------------------------------------------ inside

    @property
    def _stable(self) -> list[Piece]:
        return self._parts(stable=True)

    def _parts(self, *, stable: bool) -> list[Piece]:
        return self._once(("parts", stable), lambda: pieces_of(self.known, stable=stable))

    def _once(self, key: Any, find: Callable[[], Any]) -> Any:
        """Return what was found under a key, or find it."""
        # No cached_property: before Python 3.12 it holds a lock, while others are asked.
        if key not in self._done:
            self._done[key] = find()
        return self._done[key]

    def _variable(self, name: str) -> Variable:
        return variable_of(name, self.branch.ratio_units)

    def _peak(self, variable: str, stable: bool) -> measures.Peak:
        own, parts = self._variable(variable), self._parts(stable=stable)
        return self._once(("peak", variable, stable), lambda: measures.peak_of(parts, own))

    def _fold(self, number: int) -> Node:
        folds: list[Knot] = [k for k in knots_of(self.known) if k.kind in TURNS]
        folds.sort(key=lambda knot: knot.motion.parameter)
        if not -len(folds) <= number < len(folds):
            raise NoSuchPlace(f"The branch has {len(folds)} folds: there is no number {number}.")
        key = "fold", number % len(folds)
        return self._once(key, lambda: node_of(self.known, folds[number]))

    def _band(self, low: float | None, high: float | None) -> tuple[float, float]:
        start, end = self.branch.range
        a, b = start if low is None else float(low), end if high is None else float(high)
        for name, value in (("low", a), ("high", b)):
            allowed = f"from {start:g} to {end:g}, the range of the response"
            check_range(name, value, start, end, allowed=allowed)
        if not a < b:
            raise ValueError(f"low must be below high, got {a:g} and {b:g}.")
        return a, b

    def _give(self, dual: Dual, argument: Any = 0.0) -> Number:
        if self._plain:
            return dual.value
        value, slopes = jnp.asarray(dual.value, float), jnp.asarray(dual.slopes)
        return _number(self._moved, jnp.asarray(argument, float), value, slopes)

    def __repr__(self) -> str:
        numbers = ", ".join(f"{name}={value:g}" for name, value in self._values.items())
        return f"Response({numbers}; {self.branch.axis} {self.branch.range}; {self.shape})"


def _both(a: list[Any], b: list[Any]) -> list[Any]:
    """Where spans of both lists are, each without overlaps."""
    return measures.covered([*a, *b], least=2)


def _plain(name: str, number: Any) -> float:
    """The value of what JAX may be differentiating. Raises `ValueError` for what is no number."""
    if not (is_number(number) or (isinstance(number, jax.Array) and np.shape(number) == ())):
        raise ValueError(f"{name} must be a finite number, got {in_short(number)}.")
    return float(jax.lax.stop_gradient(number))


def _is_upper(of: str) -> bool:
    if of not in ("upper", "lower"):
        raise ValueError(f"of must be 'upper' or 'lower', got {of!r}.")
    return of == "upper"
