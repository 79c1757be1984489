"""Exact event-driven propagation of the impact reduced-order model, with numpy and scipy only.

Out of contact and in contact the model is linear with a harmonic drive, so both phases have
closed-form solutions; only the contact times are searched, and on the closed form. Nothing is
shared with `vibrojax`, so that agreement with it means something.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

_CHUNK = 192  # scan samples evaluated at once
_SAMPLES_PER_SHORTEST_PERIOD = 16
_EVENT_LIMIT = 10_000_000


@dataclass(frozen=True, eq=False)
class Problem:
    """One lane but for its drive frequency, in SI: a base-driven modal model and one stop.

    q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i = Gamma_i sigma Omega^2 sin(Omega t) + phi_i(s1) F / m_i.
    With d = side y(s1) - gap, F = -side (Ks d + Cs d') where d > 0 and zero elsewhere;
    `tension=False` also sets it to zero wherever it would pull.
    """

    angular_frequency: np.ndarray
    damping_ratio: np.ndarray | float
    modal_mass: np.ndarray
    participation: np.ndarray
    shape_at_stop: np.ndarray
    shape_at_tip: np.ndarray
    gap: float
    stiffness: float
    damping: float
    base_amplitude: float
    side: float = 1.0
    tension: bool = True

    @property
    def num_modes(self) -> int:
        return len(self.angular_frequency)

    def tip(self, states: np.ndarray) -> np.ndarray:
        """Tip displacement relative to the base, of states (..., 2N)."""
        return np.asarray(states)[..., : self.num_modes] @ np.asarray(self.shape_at_tip)

    def penetration(self, states: np.ndarray) -> np.ndarray:
        """Penetration d into the stop, negative out of contact."""
        displacement = np.asarray(states)[..., : self.num_modes] @ np.asarray(self.shape_at_stop)
        return self.side * displacement - self.gap

    def contact_force(self, states: np.ndarray) -> np.ndarray:
        """Force the beam exerts on the stop; positive pushes."""
        depth = self.penetration(states)
        rate = (
            self.side * np.asarray(states)[..., self.num_modes :] @ np.asarray(self.shape_at_stop)
        )
        force = np.where(depth > 0.0, self.stiffness * depth + self.damping * rate, 0.0)
        return force if self.tension else np.maximum(force, 0.0)

    def truncated(self, num_modes: int) -> Problem:
        """The same rig with its first modes only."""
        if not 1 <= num_modes <= self.num_modes:
            raise ValueError(f"num_modes must be 1 to {self.num_modes}, got {num_modes}")
        per_mode = ("angular_frequency", "modal_mass", "participation", "shape_at_stop")
        cut = {n: np.asarray(getattr(self, n))[:num_modes] for n in (*per_mode, "shape_at_tip")}
        zeta = self.damping_ratio
        cut["damping_ratio"] = zeta if np.ndim(zeta) == 0 else np.asarray(zeta)[:num_modes]
        return replace(self, **cut)

    @cached_property
    def _scale(self) -> np.ndarray:
        """Diagonal map to (sqrt(m) w q, sqrt(m) q'), in which the motion is near normal."""
        root = np.sqrt(self.modal_mass)
        return np.concatenate([root * self.angular_frequency, root])

    @cached_property
    def _gap_row(self) -> np.ndarray:
        """Row r of the scaled state with side y(s1) = r x."""
        zeros = np.zeros(self.num_modes)
        return self.side * np.concatenate([self.shape_at_stop, zeros]) / self._scale

    @cached_property
    def _rate_row(self) -> np.ndarray:
        zeros = np.zeros(self.num_modes)
        return self.side * np.concatenate([zeros, self.shape_at_stop]) / self._scale

    def _generator(self, *, contact: bool) -> tuple[np.ndarray, np.ndarray]:
        """A and constant c of the scaled x' = A x + c + drive."""
        n = self.num_modes
        w = np.asarray(self.angular_frequency, float)
        generator, constant = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
        generator[:n, n:] = np.diag(w)
        generator[n:, :n] = -np.diag(w)
        generator[n:, n:] = -np.diag(2.0 * np.broadcast_to(self.damping_ratio, (n,)) * w)
        if contact:
            push = self.side * np.asarray(self.shape_at_stop) / np.sqrt(self.modal_mass)
            row = self.stiffness * self._gap_row + self.damping * self._rate_row
            generator[n:] -= np.outer(push, row)
            constant[n:] = push * self.stiffness * self.gap
        return generator, constant


class _Functional:
    """r . x(t) + offset and its time derivative along one phase's closed-form solution."""

    def __init__(self, flow: _Flow, row: np.ndarray, offset: float):
        self.weights = np.stack([row @ flow.vectors, (row @ flow.vectors) * flow.rates])
        response = row @ flow.harmonic
        self.harmonic = np.array([response, 1j * flow.drive * response])
        self.offset = np.array([offset + row @ flow.rest, 0.0])
        self.flow = flow

    def on_chunk(self, amplitudes, phasor, start: int):
        """(2, samples): value and derivative on the scan grid from sample `start`."""
        flow = self.flow
        decay = np.exp(flow.rates * (start * flow.step))
        turn = phasor * np.exp(1j * flow.drive * start * flow.step)
        modal = (self.weights * (amplitudes * decay)) @ flow.grid_decay
        forced = np.outer(self.harmonic * turn, flow.grid_turn)
        return modal.real + forced.imag + self.offset[:, None]

    def at(self, which: int, amplitudes, phasor):
        """Scalar function of the time since the phase began."""
        weights, flow = self.weights[which] * amplitudes, self.flow
        forced, offset = self.harmonic[which] * phasor, self.offset[which]

        def value(elapsed: float) -> float:
            modal = np.dot(weights, np.exp(flow.rates * elapsed)).real
            return modal + (forced * np.exp(1j * flow.drive * elapsed)).imag + offset

        return value


class _Flow:
    """Closed-form solution of one linear phase at one drive frequency."""

    def __init__(self, problem: Problem, drive: float, step: float, *, contact: bool):
        n = problem.num_modes
        generator, constant = problem._generator(contact=contact)
        self.drive, self.step = drive, step
        self.rates, self.vectors = np.linalg.eig(generator)
        if np.linalg.cond(self.vectors) > 1e8:
            raise ValueError("a critically damped phase has no eigenvector basis")
        self.inverse = np.linalg.inv(self.vectors)
        forcing = np.zeros(2 * n)
        forcing[n:] = np.sqrt(problem.modal_mass) * problem.participation
        forcing *= problem.base_amplitude * drive**2
        self.harmonic = np.linalg.solve(1j * drive * np.eye(2 * n) - generator, forcing)
        self.rest = -np.linalg.solve(generator, constant)
        grid = step * np.arange(_CHUNK + 1)
        self.grid_decay = np.exp(np.outer(self.rates, grid))
        self.grid_turn = np.exp(1j * drive * grid)

    def amplitudes(self, state: np.ndarray, time: float) -> np.ndarray:
        phasor = np.exp(1j * self.drive * time)
        return self.inverse @ (state - (self.harmonic * phasor).imag - self.rest)

    def states(self, amplitudes: np.ndarray, start: float, elapsed: np.ndarray) -> np.ndarray:
        elapsed = np.atleast_1d(elapsed)
        decay = np.exp(np.multiply.outer(elapsed, self.rates))
        turn = np.exp(1j * self.drive * start) * np.exp(1j * self.drive * elapsed)
        forced = np.multiply.outer(turn, self.harmonic).imag
        return ((decay * amplitudes) @ self.vectors.T).real + forced + self.rest


def _root(function, low: float, high: float) -> float:
    if function(low) == 0.0:
        return low
    if function(low) * function(high) > 0.0:  # round-off at a graze: the end nearer to zero
        return low if abs(function(low)) < abs(function(high)) else high
    return brentq(function, low, high, xtol=1e-19, rtol=4 * np.finfo(float).eps)


def _first_exit(margin: _Functional, amplitudes, phasor, horizon: float, *, at_zero: bool):
    """First time at which a margin, positive inside its phase, turns negative, or None.

    `at_zero` says that the phase began on this margin's zero.
    """
    flow = margin.flow
    value, slope = margin.at(0, amplitudes, phasor), margin.at(1, amplitudes, phasor)
    start = 0
    while start * flow.step < horizon:
        g, dg = margin.on_chunk(amplitudes, phasor, start)
        if start == 0 and at_zero:
            g[0] = 0.0
        left = g[1:] < 0.0
        dip = (g[1:] >= 0.0) & (dg[:-1] < 0.0) & (dg[1:] > 0.0)
        for k in np.flatnonzero(left | dip):
            low, high = (start + k) * flow.step, (start + k + 1) * flow.step
            if low >= horizon:
                return None
            began = start + k == 0 and at_zero
            if left[k]:
                if not began:
                    exit_time = _root(value, low, high)
                elif dg[0] > 0.0 and dg[1] < 0.0:  # rose and fell within one cell
                    exit_time = _root(value, _root(slope, low, high), high)
                else:
                    exit_time = 0.0
            else:
                bottom = _root(slope, low, high)
                if value(bottom) >= 0.0 or (began and dg[0] < 0.0):
                    continue
                exit_time = _root(value, low, bottom)
            return exit_time if exit_time < horizon else None
        start += _CHUNK
    return None


def propagate(problem: Problem, drive_frequency, state0, t0, t_end, sample_times):
    """States (times, 2N) in (q, q') at the sorted `sample_times`, and the list of event times.

    `drive_frequency` is angular (rad/s). Events are entries into and exits from contact (and,
    without tension, the loss and return of the force while still beyond the gap).
    """
    drive = float(drive_frequency)
    no_tension = not problem.tension and problem.damping > 0.0
    fastest = max(
        np.abs(np.linalg.eigvals(problem._generator(contact=contact)[0]).imag).max()
        for contact in (False, True)
    )
    step = 2.0 * np.pi / max(fastest, drive) / _SAMPLES_PER_SHORTEST_PERIOD
    flows = {c: _Flow(problem, drive, step, contact=c) for c in (False, True)}
    gap_row, gap = problem._gap_row, problem.gap
    force_row = problem.stiffness * gap_row + problem.damping * problem._rate_row
    force_zero = problem.stiffness * gap
    # phase: (flow, [(margin, next phase)])
    phases = {
        "free": (flows[False], [(_Functional(flows[False], -gap_row, gap), "contact")]),
        "contact": (flows[True], [(_Functional(flows[True], gap_row, -gap), "free")]),
    }
    if no_tension:
        push = _Functional(flows[True], force_row, -force_zero)
        pull = _Functional(flows[False], -force_row, force_zero)
        inside = _Functional(flows[False], gap_row, -gap)
        phases["contact"] = (flows[True], [(push, "slack")])
        phases["slack"] = (flows[False], [(inside, "free"), (pull, "contact")])

    samples = np.asarray(sample_times, float)
    if np.any(np.diff(samples) < 0.0) or (samples.size and samples[0] < t0):
        raise ValueError("sample_times must be sorted and not before t0")
    out = np.empty((samples.size, 2 * problem.num_modes))
    time, state = float(t0), np.asarray(state0, float) * problem._scale
    depth, rate = gap_row @ state - gap, problem._rate_row @ state
    phase = "contact" if depth > 0.0 or (depth == 0.0 and rate > 0.0) else "free"
    if phase == "contact" and no_tension and force_row @ state < force_zero:
        phase = "slack"
    came_from, events, filled = None, [], 0
    if depth == 0.0:
        came_from = "free" if phase == "contact" else "contact"
    while len(events) < _EVENT_LIMIT:
        flow, margins = phases[phase]
        amplitudes, phasor = flow.amplitudes(state, time), np.exp(1j * drive * time)
        horizon, following = t_end - time, None
        for margin, target in margins:
            # Without tension, contact begins on d = 0 and ends on zero force: not the same surface.
            same = came_from is not None and (came_from == target or phase == "free")
            elapsed = _first_exit(margin, amplitudes, phasor, horizon, at_zero=same)
            if elapsed is not None:
                horizon, following = elapsed, target
        stop = samples.size if following is None else np.searchsorted(samples, time + horizon)
        if stop > filled:
            out[filled:stop] = flow.states(amplitudes, time, samples[filled:stop] - time)
            filled = stop
        if following is None:
            return out / problem._scale, events
        state = flow.states(amplitudes, time, np.array([horizon]))[0]
        time += horizon
        events.append(time)
        came_from, phase = phase, following
    raise RuntimeError(f"more than {_EVENT_LIMIT} events")


def tip_at_period_ends(problem: Problem, drive_frequency: float, periods: int) -> np.ndarray:
    """Tip displacement at the end of each of the first periods from rest at drive phase zero."""
    ends = np.arange(1, periods + 1) * (2.0 * np.pi / drive_frequency)
    rest = np.zeros(2 * problem.num_modes)
    states, _ = propagate(problem, drive_frequency, rest, 0.0, ends[-1], ends)
    return problem.tip(states)


# Modes of tests/data/sweeps.json (5 modes, tip-normalised, consistent projection),
# made there by 50-digit power series: taper mu and mass ratio Mr of a 0.2 m x 25 mm x 1 mm beam,
# E 130 GPa, rho 8250 kg/m3. Rows: w (rad/s), m (kg), Gamma, phi(1/2).
_TAPER_HALF_MASS_HALF = np.array(  # C_MR0.5_mu0.5: mu 0.5, Mr 0.5
    [
        [57.870127869781115, 488.68373522964146, 1478.4248460390156, 3033.4350443901185,
         5153.948878161958],
        [0.026219432097602163, 0.1990063183596315, 0.546268395350797, 1.1070734870588235,
         1.8702424672773963],
        [1.151578793551094, -0.20151889122881053, 0.07317463858053283, -0.03644583020326394,
         0.021676255728605754],
        [0.2997657485057909, -3.6600345175907294, 2.013832392544216, 7.8814976555431535,
         -3.832850711702261],
    ]
)  # fmt: skip
_AT_THREE_QUARTERS = np.array(  # C_MR0.5_mu0.5_s1_0.75: phi(3/4) of the same beam
    [0.6218296801343498, -2.86617187036991, -6.390958248067963, -5.648754404337498,
     1.7077329359018023]
)  # fmt: skip
_UNIFORM_MASS_THREE_HALVES = np.array(  # C_fig7_MR1.5_mu0: mu 0, Mr 1.5
    [
        [37.65297624559763, 458.25577272880014, 1449.6086564285172, 3004.94671798857,
         5125.682387730167],
        [0.07167519063861476, 0.934747429693918, 2.588382658281283, 5.210788424902949,
         8.742547985595587],
        [1.0803535089620135, -0.10464970261543904, 0.035383727396123686, -0.017349010376147462,
         0.01026146949710188],
        [0.3161016559348524, -6.8371603204845135, 4.281565836202368, 14.692925010169326,
         -7.621545437512601],
    ]
)  # fmt: skip


def _paper_rig(modes: np.ndarray, gap: float = 0.4e-3, shape_at_stop=None) -> Problem:
    w, mass, participation, shape = modes
    return Problem(
        angular_frequency=w,
        damping_ratio=0.018,
        modal_mass=mass,
        participation=participation,
        shape_at_stop=shape if shape_at_stop is None else shape_at_stop,
        shape_at_tip=np.ones_like(w),
        gap=gap,
        stiffness=5500.0,
        damping=5e-5,
        base_amplitude=0.2e-3,
    )


def default_problem(num_modes: int = 5) -> Problem:
    """The default rig: taper 0.5, mass ratio 0.5, stop at mid-length with a gap of 0.4 mm."""
    return _paper_rig(_TAPER_HALF_MASS_HALF).truncated(num_modes)


def soft_support_problem(num_modes: int = 5, contact_damping: float = 6.85) -> Problem:
    """A uniform aluminium cantilever with a heavily damped stop at its tip, base-driven.

    0.40 m x 38 mm x 3 mm, E 70 GPa, rho 2700; 22 kN/m, gap 4 mm, damping ratio 0.01
    (Ledezma-Ramirez et al.); the drive amplitude, 1 mm, is chosen here so that it hits.
    """
    length, width, thickness, modulus, density = 0.40, 0.038, 0.003, 70e9, 2700.0
    line_mass = density * width * thickness
    bending = modulus * width * thickness**3 / 12.0
    centres = (np.arange(num_modes) + 0.5) * np.pi
    centres[0] = 1.875
    beta = np.array(
        [brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), c - 0.4, c + 0.4, xtol=1e-15)
         for c in centres]
    )  # fmt: skip
    ratio = (np.cosh(beta) + np.cos(beta)) / (np.sinh(beta) + np.sin(beta))
    sign = (-1.0) ** np.arange(num_modes)
    return Problem(
        angular_frequency=beta**2 / length**2 * np.sqrt(bending / line_mass),
        damping_ratio=0.01,
        modal_mass=np.full(num_modes, line_mass * length / 4.0),
        participation=4.0 * sign * ratio / beta,
        shape_at_stop=np.ones(num_modes),
        shape_at_tip=np.ones(num_modes),
        gap=0.004,
        stiffness=22e3,
        damping=contact_damping,
        base_amplitude=1e-3,
    )


def rigs() -> dict[str, Problem]:
    """The rigs on which work against precision is judged."""
    return {
        "default": default_problem(),
        "heavy_tip": _paper_rig(_UNIFORM_MASS_THREE_HALVES),
        "outer_stop": _paper_rig(_TAPER_HALF_MASS_HALF, shape_at_stop=_AT_THREE_QUARTERS),
        "wide_gap": _paper_rig(_TAPER_HALF_MASS_HALF, gap=0.8e-3),
        "soft_support": soft_support_problem(),
    }
