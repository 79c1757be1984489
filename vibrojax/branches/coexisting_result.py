"""Motions that coexist at one frequency, and from where each was reached."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.continue_response import continue_response
from vibrojax.history.history import History
from vibrojax.history.simulate import simulate
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SAME = 1e-3
"""Relative distance of states below which two motions are one."""


class Motion(eqx.Module):
    """One periodic motion and the starts that led to it."""

    period: int = eqx.field(static=True)
    """In drive periods."""
    amplitude_ratio: float
    """Half peak-to-peak displacement over the drive amplitude."""
    contact_force: float
    """Largest contact force, N."""
    initial_state: Float[np.ndarray, " states"]
    """(q, q') at drive phase 0."""
    starts: Int[np.ndarray, " starts"]
    """Indices of the start states that led here."""

    def __repr__(self) -> str:
        return (
            f"Motion(period={self.period}, amplitude_ratio={self.amplitude_ratio:.6g}, "
            f"contact_force={self.contact_force:.4g} N, starts: {len(self.starts)})"
        )


class Coexisting(eqx.Module):
    """What a search from many states found at one frequency, the most frequent motion first."""

    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    value: float
    """Drive frequency, in that unit."""
    motions: tuple[Motion, ...]
    """Those found, each with `period`, `amplitude_ratio`, `contact_force`, `initial_state` and
    the `starts` that led to it."""
    start_states: Float[np.ndarray, "starts states"]
    """(q, q') at drive phase 0, m and m/s, from which the search marched."""
    aperiodic: Int[np.ndarray, " aperiodic"]
    """Starts for which no period was found."""
    diverged: Int[np.ndarray, " diverged"]
    """Starts whose state stopped being finite."""
    system: AbstractSystem
    """What moves."""

    @validated
    def branches(self, bounds: tuple[float, float], **settings: Any) -> list[Branch]:
        """Follow every motion along the frequency, within the bounds, both ways.

        Motions on a branch that another one gave already are not followed again, so isolated
        branches are what comes besides the first.

        Parameters:
            bounds: lowest and highest frequency, in the unit of the axis.
            settings: those of `continue_response`, by name.

        Raises `ValueError` for bounds or settings that cannot work.
        """
        branches: list[Branch] = []
        for motion in self.motions:
            if any(self._is_on(branch, motion) for branch in branches):
                continue
            range_of: dict[str, Any] = {self.axis: bounds}
            branch = continue_response(
                self.system,
                **range_of,
                period=motion.period,
                start=(motion.initial_state, self.value),
                **settings,
            )
            assert isinstance(branch, Branch)
            branches.append(branch)
        return branches

    def _is_on(self, branch: Branch, motion: Motion) -> bool:
        if branch.period != motion.period or not len(branch.values):
            return False
        here = branch.resample([self.value])
        amplitude = np.asarray(here["amplitude_ratio"]).ravel()
        force = np.asarray(here["contact_force"]).ravel()
        near = np.abs(amplitude - motion.amplitude_ratio) < SAME * motion.amplitude_ratio
        alike = np.abs(force - motion.contact_force) <= 1e-2 * max(motion.contact_force, 1e-12)
        return bool(np.any(near & alike))

    @validated(traceable=True)
    def history(self, index: int = 0, *, samples_per_period: int = 256) -> History:
        """Return one of the motions over its period as a time history.

        Parameters:
            index: which of `motions`.
            samples_per_period: samples per drive period.

        Raises `IndexError` when there is no such motion, `ValueError` for fewer than 1 sample.
        """
        motion = self.motions[index]
        frequency: dict[str, Any] = {self.axis: self.value}
        state = eqx.filter_eval_shape(self.system.equations).split(motion.initial_state)
        return simulate(
            self.system,
            **frequency,
            periods=motion.period,
            samples_per_period=samples_per_period,
            initial_state=state,
        )

    def plot(self) -> "Figure":
        """Draw every motion in the plane of displacement (mm) and velocity (m/s).

        Dots mark the drive phase 0. Raises `ValueError` when no periodic motion was found.
        """
        if not self.motions:
            raise ValueError("No periodic motion was found: there is nothing to draw.")
        histories = [self.history(k, samples_per_period=256) for k in range(len(self.motions))]
        orbits = [(np.asarray(h.displacement()), np.asarray(h.velocity())) for h in histories]
        from vibrojax.plot.coexisting import plot_coexisting

        return plot_coexisting(self.to_xarray(), orbits, 256)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `motion`, from 1, and `start`, with units and long names."""
        import xarray

        units = self.system.drive.reference[1]
        leads_to = np.zeros(len(self.start_states), int)
        for number, motion in enumerate(self.motions, 1):
            leads_to[motion.starts] = number
        leads_to[self.diverged] = -1
        states = np.reshape([m.initial_state for m in self.motions], (len(self.motions), -1))
        shares = [len(m.starts) / len(self.start_states) for m in self.motions]

        def of_motions(name: str, values: Any) -> Any:
            return ("motion", np.asarray(values), described_as(name, units))

        data: dict[str, Any] = {
            "period": of_motions("period", [m.period for m in self.motions]),
            "amplitude_ratio": of_motions(
                "amplitude_ratio", [m.amplitude_ratio for m in self.motions]
            ),
            "contact_force": of_motions("contact_force", [m.contact_force for m in self.motions]),
            "share": of_motions("share", shares),
            "leads_to": ("start", leads_to, described_as("leads_to")),
            "start_state": (("start", "state"), self.start_states, described_as("start_state")),
        }
        if self.motions:
            described = described_as("initial_state")
            data["initial_state"] = (("motion", "state"), states, described)
        coordinates = {
            "motion": (
                "motion",
                np.arange(1, len(self.motions) + 1),
                {"units": "1", "long_name": "Motion, the most frequent first"},
            ),
            self.axis: ((), self.value, described_as(self.axis)),
        }
        title = {"title": "vibrojax coexisting motions", "rig": recipe(self.system)}
        return xarray.Dataset(data, coordinates, attrs=title)

    def __repr__(self) -> str:
        total = len(self.start_states)
        lines = [f"Coexisting({total} starts at {self.axis} = {self.value:g})"]
        for m in self.motions:
            lines.append(
                f"  period {m.period}: amplitude ratio {m.amplitude_ratio:.6g}, contact force "
                f"{m.contact_force:.4g} N, from {len(m.starts)} starts"
            )
        if len(self.aperiodic):
            lines.append(f"  no period found from {len(self.aperiodic)} starts")
        if len(self.diverged):
            lines.append(f"  diverged from {len(self.diverged)} starts")
        return "\n".join(lines)
