"""Curves with the excitation as a rig has it: a drive that gives way, points held off the sweep."""

from typing import Any, NamedTuple

import numpy as np

import vibrojax as vj

BASE = 0.2e-3
"""Amplitude of the base where the beam is at rest, m."""
DROP = 0.2
"""Share of it that is lost at the largest response."""
RELATIVE, FLOOR = 0.02, 0.05
"""Standard deviation of the noise: share of the amplitude, and least, over the drive."""


def with_noise(values: np.ndarray, floor: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return measured values and their deviations; complex ones with noise in both parts."""
    deviation = np.hypot(RELATIVE * np.abs(values), floor)
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(len(values))
    if np.iscomplexobj(values):
        return values + deviation * (noise + 1j * rng.standard_normal(len(values))), deviation
    return np.abs(values + deviation * noise), deviation


class Wandering(NamedTuple):
    """A sweep both ways while the drive falls with the response, as that of a weak shaker does."""

    frequency: np.ndarray
    direction: np.ndarray
    displacement: np.ndarray
    """m."""
    drive: np.ndarray
    """m."""

    @classmethod
    def swept(cls, ratios: np.ndarray, levels: int, **numbers: float) -> "Wandering":
        """Of settled sweeps at some drive levels, point by point the one that the drive has."""
        drives = BASE * np.linspace(1 - DROP, 1.0, levels)
        settled = []
        for drive in drives:
            rig = vj.default_rig(base_amplitude=drive, **numbers)
            sweep = vj.frequency_sweep(rig, frequency_ratio=ratios)
            settled.append(np.asarray(sweep.amplitude_ratio).ravel() * drive)
        moved = np.array(settled)
        wanted = BASE * (1 - DROP * moved / moved.max())
        chosen = np.argmin(np.abs(drives[:, None] - wanted), axis=0)
        displacement = np.take_along_axis(moved, chosen[None], axis=0)[0]
        way = np.repeat([1, -1], len(ratios))
        return cls(np.tile(ratios, 2), way, displacement, drives[chosen])

    def measured(self, seed: int, known: bool) -> vj.io.MeasuredCurve:
        """Return it with noise, and with the drive at every point if that is known."""
        amplitude, deviation = with_noise(self.displacement, FLOOR * BASE, seed)
        about: dict[str, Any] = {"drive_signal": "displacement"}
        if known:
            about["drive_amplitude"] = self.drive
        return vj.io.MeasuredCurve(
            self.frequency,
            "frequency_ratio",
            amplitude,
            deviation,
            direction=self.direction,
            is_ratio=False,
            **about,
        )


class Held(NamedTuple):
    """Points along the whole branch, unstable too, as control or stepped phase hold them."""

    frequency: np.ndarray
    response: np.ndarray
    """First harmonic over the drive, complex."""
    stable: np.ndarray

    @classmethod
    def along(cls, low: float, high: float, points: int, **numbers: float) -> "Held":
        """Take exact motions evenly along the branch."""
        rig = vj.default_rig(**numbers)
        branch = vj.continue_response(rig, frequency_ratio=vj.Range(low, high)).to_xarray()
        length = branch["arclength"].values
        evenly = np.interp(np.linspace(0, length[-1], points), length, np.arange(len(length)))
        at = np.unique(evenly.astype(int))
        frequency = branch["frequency_ratio"].values[at]
        response = []
        for ratio, state in zip(frequency, branch["initial_state"].values[at], strict=True):
            turn = vj.simulate(
                rig, frequency_ratio=float(ratio), initial_state=state, periods=1, samples=256
            )
            back = np.exp(-2j * np.pi * np.arange(256) / 256)
            phasor = 2 / 256 * np.sum(np.asarray(turn.displacement())[:256] * back)
            response.append(1j * phasor / BASE)  # over a drive that is a sine
        return cls(frequency, np.array(response), branch["stable"].values[at] == 1)

    def measured(self, seed: int, kind: str) -> vj.io.MeasuredCurve:
        """Return points with noise: `complex`, their `amplitudes`, or the `stable` of these."""
        response, deviation = with_noise(self.response, FLOOR, seed)
        kept = self.stable if kind == "stable" else np.ones(len(response), bool)
        return vj.io.MeasuredCurve(
            self.frequency[kept],
            "frequency_ratio",
            response[kept] if kind == "complex" else np.abs(response[kept]),
            deviation[kept],
            quantity="first_harmonic",
        )
