"""Where the energy of a history is and where it goes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_choice
from vibrojax._tools.signatures import validated
from vibrojax.history.between_samples import engine_of
from vibrojax.history.corners import cut_at_corners, own_interval
from vibrojax.history.quantities import dataset, numbered
from vibrojax.history.samples import SampledMotion, times_of

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


KINDS = ("stacked", "lines")


@dataclass(frozen=True, eq=False, repr=False)
class EnergyFlow:
    """Energy of the modes and the stops at every sample, and what was lost and put in till then.

    Energies are those of the motion relative to the base; the modes are those of the system out of
    contact.
    """

    time: Float[np.ndarray, " samples"]
    """s."""
    modal_energy: Float[np.ndarray, "samples modes"]
    """Kinetic and strain energy of every mode, J."""
    stop_energy: Float[np.ndarray, "samples stops"]
    """Energy stored in every stop, J."""
    beam_loss: Float[np.ndarray, "samples modes"]
    """Lost by modal damping since the start, J; where it couples modes, to the mode it slows."""
    contact_loss: Float[np.ndarray, "samples stops"]
    """Lost in every stop since the start, J."""
    input_work: Float[np.ndarray, " samples"]
    """Work of the drive since the start, J: of the force, or of the inertial force of the base, and
    of forces that stay the same."""

    @property
    def share(self) -> Float[np.ndarray, "samples modes"]:
        """Share of every mode in the energy of the body; 0 where that has none."""
        total = self.modal_energy.sum(axis=1, keepdims=True)
        return self.modal_energy / np.where(total > 0, total, 1.0)

    @property
    def total(self) -> Float[np.ndarray, " samples"]:
        """Energy of the body and the stops, J."""
        return self.modal_energy.sum(axis=1) + self.stop_energy.sum(axis=1)

    @property
    def balance(self) -> Float[np.ndarray, " samples"]:
        """Energy that is unaccounted for, by the largest energy held or lost: 0 but for errors."""
        lost = self.beam_loss.sum(axis=1) + self.contact_loss.sum(axis=1)
        missing = self.total - self.total[0] + lost - self.input_work
        size = max(np.max(self.total), np.max(np.abs(lost)), np.max(np.abs(self.input_work)))
        return missing / (size if size > 0 else 1.0)

    @validated
    def mean_share(
        self, start: float | int | None = None, stop: float | int | None = None
    ) -> Float[np.ndarray, " modes"]:
        """Return the mean share of every mode between two times (s), by default all of them.

        Raises `ValueError` when no sample lies between them.

        Parameters:
            start: first time, s; None: from the start of the history.
            stop: last time, s; None: to its end.
        """
        inside = np.ones(self.time.size, bool)
        if start is not None:
            inside &= self.time >= start
        if stop is not None:
            inside &= self.time <= stop
        if not inside.any():
            raise ValueError(
                f"No sample lies between start = {start!r} and stop = {stop!r}: the history runs "
                f"from {self.time[0]:.6g} to {self.time[-1]:.6g} s."
            )
        return self.share[inside].mean(axis=0)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over time, mode and stop, with units and long names."""
        over_mode, over_stop, over_time = ("time", "mode"), ("time", "stop"), ("time",)
        described = {
            "modal_energy": ("J", "Energy of the modes", over_mode),
            "share": ("1", "Share of the energy of the body", over_mode),
            "stop_energy": ("J", "Energy stored in the stops", over_stop),
            "beam_loss": ("J", "Cumulated loss by modal damping", over_mode),
            "contact_loss": ("J", "Cumulated loss in the stops", over_stop),
            "input_work": ("J", "Cumulated work of drive and constant forces", over_time),
            "balance": ("1", "Energy unaccounted for, by the largest", over_time),
            "time": ("s", "Time", over_time),
        }
        return dataset(
            {name: (dims, getattr(self, name), *rest) for name, (*rest, dims) in described.items()},
            numbered("mode", self.modal_energy.shape[1])
            | numbered("stop", self.stop_energy.shape[1]),
        )

    @validated
    def plot(self, kind: str = "stacked") -> "Figure":
        """Draw the share of every mode against time, and the losses and the input below it.

        `kind` is `stacked` (shares add up to 1) or `lines` (on a logarithmic axis, which shows
        small shares).

        Raises `ValueError` for another kind.
        """
        check_choice("kind", kind, KINDS)
        from vibrojax.plot.history import plot_energy

        return plot_energy(self.to_xarray(), kind)

    def __repr__(self) -> str:
        shares = ", ".join(f"{100 * share:.3g}" for share in self.mean_share())
        return (
            f"EnergyFlow(0 to {self.time[-1]:.6g} s, mean shares of the modes {shares} %, lost in "
            f"the body {self.beam_loss[-1].sum():.4g} J, in the stops "
            f"{self.contact_loss[-1].sum():.4g} J, put in {self.input_work[-1]:.4g} J)"
        )


def energy_of(history: SampledMotion) -> EnergyFlow:
    """Follow the energy of a history; see `History.energy`."""
    linear = history.motion.equations.linear_between_contacts
    if linear is not None and linear.stiffness_coupling is not None:
        raise ValueError("A StateSpace does not say its masses: its histories have no energies.")
    time, states = times_of(history, "energies"), np.asarray(history.states)
    engine, equations = engine_of(history.motion), history.motion.equations
    mass, stiffness = (np.asarray(getattr(equations, f"modal_{n}")) for n in ("mass", "stiffness"))
    n, stops, count = mass.size, history.contact_force.shape[1], time.size
    beam_loss, input_work = np.zeros((count, n)), np.zeros(count)
    taken, stored = np.zeros((count, stops)), np.zeros((count, stops))
    cut, cut_states = cut_at_corners(history.motion, time, states)
    own = own_interval(cut, time)
    for cells in engine.cells(history.motion, cut, cut_states):
        interval = own[cells.interval]
        np.add.at(beam_loss, interval + 1, cells.beam_loss.T)
        np.add.at(input_work, interval + 1, cells.input_work)
        work = cells.loss + cells.stored_end - cells.stored_start
        np.add.at(taken, interval + 1, work.T)
        intervals, first = np.unique(interval, return_index=True)
        stored[intervals] = cells.stored_start.T[first]
        stored[-1] = cells.stored_end[:, -1]
    return EnergyFlow(
        time=time,
        modal_energy=mass * (states[:, n : 2 * n] ** 2 + stiffness * states[:, :n] ** 2) / 2,
        stop_energy=stored,
        beam_loss=np.cumsum(beam_loss, axis=0),
        contact_loss=np.cumsum(taken, axis=0) - (stored - stored[0]),
        input_work=np.cumsum(input_work),
    )
