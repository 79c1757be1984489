"""Runs driven at 16 Hz: the ten forces of Table 1, read both ways, and the 12 N of Table 2."""

import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import rig
from reading import part, peak_in_g, period
from rig import FORCE_FREQUENCY

import vibrojax as vj

SPAN, SEGMENT = 800.0, 2.0
RATE = 2 * 2.56 * SPAN
SAMPLES = round(RATE / FORCE_FREQUENCY)
START = 2.0
"""s; the record of the analyser begins here, the start-up ends."""
STEADY = 2.0
"""s at the end of a run that count as its steady state; as many samples as the start-up."""
READINGS = {"amplitude": 1.0, "rms": float(np.sqrt(2.0))}
NAMED = {1: "16 Hz", 2: "32 Hz", 3: "48 Hz", 6: "96 Hz (mode 2)", 17: "272 Hz (mode 3)"}
"""Multiples of the drive that the paper speaks of."""


class Cosine(vj.Harmonic):
    """cos(2 pi frequency t): the force is there at once, the real part of F exp(i w t)."""

    def phase(self, time):
        angle, rate, second = super().phase(time)
        return angle + jnp.pi / 2, rate, second


class Forced(NamedTuple):
    """One run and what is read off it."""

    force: float
    """As the paper gives it, N."""
    history: vj.history.History
    spectrum: vj.history.Spectrum


def run(
    averages: int = 30, readings: dict[str, float] = READINGS
) -> tuple[dict[str, list[Forced]], dict[str, float]]:
    """Return the ten runs of both readings, and how long compiling, running and spectra took."""
    duration = START + SEGMENT * (averages + 1) / 2
    found, seconds = {}, []
    for factor in readings.values():
        begun = time.perf_counter()
        histories = vj.simulate(
            rig.forced_rig,
            force=[factor * force for force in rig.FORCES],
            frequency=FORCE_FREQUENCY,
            duration=duration,
            sampling_rate=RATE,
        )
        jax.block_until_ready(histories.lanes.time)
        seconds.append(time.perf_counter() - begun)
        found[factor] = list(histories)
    begun = time.perf_counter()
    runs = {
        reading: [
            Forced(force, history, spectrum_of(history, averages))
            for force, history in zip(rig.FORCES, found[factor], strict=True)
        ]
        for reading, factor in readings.items()
    }
    spectra = (time.perf_counter() - begun) / len(readings)
    took = {"first_call_s": seconds[0], "second_call_s": seconds[-1], "spectra_s": spectra}
    took["compile_s"] = seconds[0] - seconds[-1]
    return runs, {name: round(value, 2) for name, value in took.items()}


def spectrum_of(history: vj.history.History, averages: int) -> vj.history.Spectrum:
    return history.spectrum(
        "acceleration",
        start=START,
        segment=SEGMENT,
        overlap=0.5,
        averages=averages,
        window="hann",
        scaling="peak",
        span=SPAN,
        units="g",
    )


def steady(history: vj.history.History) -> vj.history.History:
    end = float(history.time[-1])
    return part(history, end - STEADY, end)


def table(runs: list[Forced]) -> list[dict]:
    rows = []
    for one in runs:
        last, first = steady(one.history), part(one.history, 0.0, START)
        contacts, lines = last.contacts(), one.spectrum.peaks(40)
        periods = STEADY * FORCE_FREQUENCY
        at_drive = line(one.spectrum, 1)
        sidebands = [p for p in lines if p.drive_order is not None]
        rows.append(
            {
                "force_N": one.force,
                "period": period(last, SAMPLES),
                "contacts_per_period": len(contacts) / periods,
                "peak_acceleration_g": peak_in_g(last),
                "peak_force_N": float(np.max(contacts.peak_force, initial=0.0)),
                "start_up_acceleration_g": peak_in_g(first),
                "start_up_force_N": float(np.max(first.contacts().peak_force, initial=0.0)),
                "tip_m": [float(f(last.displacement())) for f in (np.min, np.max)],
                "lines_over_16_Hz": {f"{n}": line(one.spectrum, n) / at_drive for n in NAMED},
                "line_at_16_Hz_g": at_drive,
                "lines": [[round(p.frequency, 2), round(p.amplitude, 5), p.name] for p in lines],
                "lines_that_are_multiples_of_the_drive": len(sidebands),
                "power_in_multiples": share_in_multiples(one.spectrum),
            }
        )
    return rows


def line(spectrum: vj.history.Spectrum, order: int) -> float:
    """Return the amplitude at a multiple of the drive, g."""
    return float(spectrum.amplitude[round(order * FORCE_FREQUENCY * spectrum.segment)])


def share_in_multiples(spectrum: vj.history.Spectrum) -> float:
    """Return the share of the power that lies within one and a half lines of multiples of 16 Hz."""
    off = np.abs(spectrum.frequency / FORCE_FREQUENCY - np.round(spectrum.frequency / 16))
    near = off * FORCE_FREQUENCY <= 1.5 * spectrum.resolution
    power = spectrum.amplitude**2
    return float(power[near & (spectrum.frequency > 8)].sum() / power[spectrum.frequency > 8].sum())


def twelve_newtons(dampings: list[float], duration: float = 16.0) -> dict[str, dict]:
    """Peaks at 12 N and 16 Hz: both readings, steady and from rest, sine and cosine start."""
    found = {}
    for reading, factor in READINGS.items():
        histories = vj.simulate(
            rig.forced_rig,
            force=12.0 * factor,
            damping=dampings,
            frequency=FORCE_FREQUENCY,
            duration=duration,
            sampling_rate=RATE,
        )
        numbers: dict[str, list] = {"damping": dampings}
        for damping, history in zip(dampings, histories, strict=True):
            last, sine = steady(history), part(history, 0.0, START)
            cosine = vj.simulate(
                rig.forced_rig(12.0 * factor, damping),
                waveform=Cosine(FORCE_FREQUENCY),
                duration=START,
                sampling_rate=RATE,
                gradient="forward",
            )
            row = {"steady_period": period(last, SAMPLES)}
            for name, one in (("steady", last), ("sine", sine), ("cosine", cosine)):
                row[f"{name}_acceleration_g"] = peak_in_g(one)
                row[f"{name}_force_N"] = float(np.max(one.contacts().peak_force, initial=0.0))
            for name, value in row.items():
                numbers.setdefault(name, []).append(value)
        found[reading] = numbers
    return found


def table_of_energy(energy: vj.history.EnergyFlow) -> dict:
    """Energy of a forced run: where it is and where it goes, from START on."""
    after = energy.time >= START
    length = energy.time[-1] - energy.time[after][0]

    def power(values: np.ndarray) -> list[float]:
        rate = (values[-1] - values[after][0]) / length
        return np.atleast_1d(rate).tolist()

    return {
        "mean_share": energy.mean_share(START).tolist(),
        "input_W": power(energy.input_work)[0],
        "beam_loss_by_mode_W": power(energy.beam_loss),
        "contact_loss_W": power(energy.contact_loss)[0],
        "balance": float(np.abs(energy.balance).max()),
    }
