"""Identification tried on curves whose contact is known: recovery, coverage, and where it misleads.

python experiments/identification/run.py                     everything, some 17 minutes
python experiments/identification/run.py --only coverage     one part: see PARTS
python experiments/identification/run.py --quick --to FOLDER coarse, to see that everything runs
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import excitation
import numpy as np
import pictures

import vibrojax as vj

HERE = Path(__file__).parent
STIFFNESS = 5500.0
DAMPINGS = (5e-5, 2.0)
RATIOS = np.linspace(0.85, 1.31, 50)
WAYS = np.repeat([1, -1], len(RATIOS))
RELATIVE, FLOOR = 0.02, 0.05
"""Standard deviation of the noise: share of the amplitude, and least."""
GUESS = {"stiffness": 5000.0, "damping": 1e-2}
EARLY = 3
"""Points by which the forward sweep jumps early."""
GAPS = (0.3e-3, 0.4e-3, 0.8e-3)

_swept: dict[tuple[float, float], np.ndarray] = {}


class Timer(NamedTuple):
    """Clock and processor time since it was made."""

    wall: float
    processor: float

    @classmethod
    def start(cls) -> "Timer":
        return cls(time.perf_counter(), time.process_time())

    def read(self) -> dict[str, float]:
        return {
            "wall_s": round(time.perf_counter() - self.wall, 2),
            "processor_s": round(time.process_time() - self.processor, 2),
        }


def clean(damping: float, gap: float = 0.4e-3) -> np.ndarray:
    """Return the settled amplitudes of the default rig, forward and then backward."""
    if (damping, gap) not in _swept:
        rig = vj.default_rig(stiffness=STIFFNESS, damping=damping, gap=gap)
        sweep = vj.frequency_sweep(rig, frequency_ratio=RATIOS)
        assert (np.asarray(sweep.status) == vj.Status.settled.value).all()
        _swept[damping, gap] = np.asarray(sweep.amplitude_ratio).ravel()
    return _swept[damping, gap]


def measured(amplitude: np.ndarray, seed: int, **about: Any) -> vj.io.MeasuredCurve:
    """Return the amplitudes with noise."""
    deviation = np.hypot(RELATIVE * amplitude, FLOOR)
    noise = np.random.default_rng(seed).normal(size=amplitude.size)
    return vj.io.MeasuredCurve(
        np.tile(RATIOS, 2),
        "frequency_ratio",
        amplitude=np.abs(amplitude + deviation * noise),
        amplitude_deviation=deviation,
        direction=WAYS,
        **about,
    )


def early(amplitude: np.ndarray) -> np.ndarray:
    """Let the forward sweep jump `EARLY` points early, onto what the backward sweep showed."""
    forward, backward = amplitude.reshape(2, -1)
    apart = np.flatnonzero(np.abs(forward - backward) > 1.0)
    forward = forward.copy()
    forward[apart[-EARLY:]] = backward[apart[-EARLY:]]
    return np.concatenate([forward, backward])


def numbers(fit: vj.identification.Identification) -> dict[str, Any]:
    """Return what the tables need of a fit."""
    return {
        "estimate": fit.estimate,
        "interval": {n: list(map(float, i)) for n, i in fit.interval.items()},
        "identifiable": {n: bool(i) for n, i in fit.identifiable.items()},
        "reduced_chi_square": fit.reduced_chi_square,
        "evaluations": fit.evaluations,
        "alternatives": len(fit.alternatives),
        "warnings": list(fit.warnings),
    }


def curve_of(fit: vj.identification.Identification, measurement: int = 0) -> dict[str, Any]:
    """Return the points and the fitted curve for a picture."""
    m, p = fit.measured[measurement], fit.predictions[measurement]
    return {
        "frequency": np.round(m.frequency, 5).tolist(),
        "direction": m.direction.tolist(),
        "amplitude": np.round(m.amplitude, 4).tolist(),
        "residual": np.round(p["residual"].values, 3).tolist(),
        "curve_frequency": np.round(p["curve_frequency"].values, 5).tolist(),
        "curve_amplitude": np.round(p[f"curve_{m.quantity}"].values, 4).tolist(),
        **phases_of(m, p),
        "unstable": p["curve_unstable"].values.tolist(),
        "continues": p["curve_continues"].values.tolist(),
    }


def phases_of(m: vj.io.MeasuredCurve, p: Any) -> dict[str, Any]:
    """Return the phases of points and curve, where they were measured."""
    if m.phase is None:
        return {}
    return {
        "phase": np.round(p["measured_phase"].values, 4).tolist(),
        "curve_phase": np.round(p["curve_phase"].values, 4).tolist(),
    }


def timed(fit: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    timer = Timer.start()
    found = fit()
    return found, timer.read()


def name_of(damping: float) -> str:
    return f"damping {damping:g}"


def recovery(quick: bool) -> dict[str, Any]:
    """Fit one curve of each truth from nine poor guesses."""
    guesses = [(s, c) for s in (500.0, 5000.0, 50000.0) for c in (1e-6, 1e-2, 10.0)]
    again = (guesses[0], guesses[4], guesses[8])
    if quick:
        guesses, again = guesses[4:5], ()
    table: dict[str, Any] = {}
    for damping in DAMPINGS[: 1 if quick else 2]:
        data, rows = measured(clean(damping), seed=0), []
        for s, c in guesses:

            def fit(s=s, c=c, data=data):
                return vj.identify(vj.default_rig, data, {"stiffness": s, "damping": c})

            found, first = timed(fit)
            row = {"guess": {"stiffness": s, "damping": c}, **numbers(found), "first_call": first}
            if (s, c) in again:
                row["again"] = timed(fit)[1]
            rows.append(row)
            print(f"{name_of(damping)} from {s:g}, {c:g}: {found.estimate} {row}", flush=True)
        table[name_of(damping)] = rows
    return table


def fit_draws(
    draw: Callable[[int], vj.io.MeasuredCurve], seeds: Iterable[int], group: int = 10, **how: Any
) -> tuple[list[vj.identification.Identification], dict[str, float]]:
    """Fit draws of the noise in groups, each by itself."""
    seeds, timer, found = list(seeds), Timer.start(), []
    for k in range(0, len(seeds), group):
        data = [draw(seed) for seed in seeds[k : k + group]]
        found += vj.identify(vj.default_rig, data, GUESS, together=False, **how)
        print(f"{k + len(data)} of {len(seeds)}: {timer.read()}", flush=True)
    return found, timer.read()


def summary(fits: Sequence[dict[str, Any]], damping: float) -> dict[str, Any]:
    """Return coverage and bias of fits of repeated noise."""
    truth = {"stiffness": STIFFNESS, "damping": damping}
    said: dict[str, Any] = {"draws": len(fits)}
    for name, true in truth.items():
        low, high = np.array([f["interval"][name] for f in fits]).T
        values = np.array([f["estimate"][name] for f in fits])
        said[name] = {
            "inside": int(np.sum((low <= true) & (true <= high))),
            "mean": float(values.mean()),
            "bias": float(values.mean() - true),
            "bias_deviation": float(values.std(ddof=1) / np.sqrt(len(values))),
            "scatter": float(values.std(ddof=1)),
            "mean_half_width": float(np.mean(high - low) / 2),
            "largest_upper_end": float(high.max()),
            "smallest_lower_end": float(low.min()),
            "only_bounded": int(sum(not f["identifiable"][name] for f in fits)),
        }
    said["mean_reduced_chi_square"] = float(np.mean([f["reduced_chi_square"] for f in fits]))
    said["with_warnings"] = sum(bool(f["warnings"]) for f in fits)
    return said


def coverage(quick: bool) -> dict[str, Any]:
    """Fit 40 draws of the noise for each truth: is the truth inside as often as it should be?"""
    table = {}
    for damping in DAMPINGS[: 1 if quick else 2]:
        draw = partial(measured, clean(damping))
        fits, took = fit_draws(draw, range(100, 102 if quick else 140))
        rows = [numbers(f) for f in fits]
        table[name_of(damping)] = {"summary": summary(rows, damping), "took": took, "fits": rows}
        print(name_of(damping), json.dumps(table[name_of(damping)]["summary"]), flush=True)
    return table


def early_jump(quick: bool) -> dict[str, Any]:
    """Fit forward sweeps that jumped early, by each objective, beside untouched ones."""
    table: dict[str, Any] = {"curves": {}}
    damping = DAMPINGS[0]
    for objective in ("distance",) if quick else ("distance", "pointwise", "folds"):
        for kind, amplitude in (("early", early(clean(damping))), ("whole", clean(damping))):
            if quick and kind == "whole":
                continue
            seeds = range(100, 102 if quick else 108)
            fits, took = fit_draws(partial(measured, amplitude), seeds, objective=objective)
            rows = [numbers(f) for f in fits]
            key = f"{name_of(damping)} {objective} {kind}"
            table[key] = {"summary": summary(rows, damping), "took": took, "fits": rows}
            if kind == "early":
                table["curves"][key] = curve_of(fits[0])
            print(key, json.dumps(table[key]["summary"]), rows[0]["warnings"], flush=True)
    return table


def model_error(quick: bool) -> dict[str, Any]:
    """Fit curves of 5 modes, consistent, with models that are wrong."""
    models: dict[str, dict[str, Any]] = {
        "as printed": {"formulation": "as_printed"},
        "1 mode": {"num_modes": 1},
        "2 modes": {"num_modes": 2},
        "3 modes": {"num_modes": 3},
        "gap 5 % too wide": {"gap": 0.42e-3},
        "damping ratio 0.020": {"damping_ratio": 0.020},
        "right": {},
    }
    if quick:
        models = {name: models[name] for name in ("damping ratio 0.020", "right")}
    table: dict[str, Any] = {"curves": {}}
    for name, how in models.items():
        for damping in DAMPINGS[:1] if quick else DAMPINGS:
            data = measured(clean(damping), seed=0)
            fit, took = timed(
                lambda data=data, how=how: vj.identify(vj.default_rig, data, GUESS, **how)
            )
            key = f"{name_of(damping)} {name}"
            table[key] = {**numbers(fit), "took": took}
            table["curves"][key] = curve_of(fit)
            print(key, fit, took, flush=True)
    return table


def gaps(quick: bool) -> dict[str, Any]:
    """Fit curves with three gaps at once, and each by itself."""
    table: dict[str, Any] = {"curves": {}}
    for damping in DAMPINGS[:1] if quick else DAMPINGS:
        data = [
            measured(clean(damping, gap), seed, parameters={"gap": gap}, label=f"{gap * 1e3:g} mm")
            for seed, gap in enumerate(GAPS[: 2 if quick else 3])
        ]
        each = [] if quick else [(m.label, m) for m in data]
        for name, given in [("together", data), *each]:
            fit, took = timed(lambda given=given: vj.identify(vj.default_rig, given, GUESS))
            key = f"{name_of(damping)} {name}"
            table[key] = {**numbers(fit), "took": took}
            print(key, fit, took, flush=True)
            if name == "together":
                table["curves"][key] = {
                    m.label: curve_of(fit, k) for k, m in enumerate(fit.measured)
                }
    return table


def free_gap(quick: bool) -> dict[str, Any]:
    """Fit the gap as well, from one far off."""
    table: dict[str, Any] = {}
    for damping in DAMPINGS[:1] if quick else DAMPINGS:
        data = measured(clean(damping), seed=0)
        for gap in (0.5e-3,) if quick else (0.2e-3, 0.5e-3, 0.8e-3):
            guess = {"stiffness": 2000.0, "damping": 1e-2, "gap": gap}
            fit, took = timed(
                lambda data=data, guess=guess: vj.identify(vj.default_rig, data, guess)
            )
            key = f"{name_of(damping)} from gap {gap:g}"
            table[key] = {**numbers(fit), "correlation": fit.correlation.tolist(), "took": took}
            print(key, fit, took, flush=True)
    return table


def drive(quick: bool) -> dict[str, Any]:
    """Fit sweeps whose drive falls by a fifth with the response: known at every point, or not."""
    damping, table = DAMPINGS[1], {"curves": {}}
    swept = excitation.Wandering.swept(
        RATIOS, 3 if quick else 17, stiffness=STIFFNESS, damping=damping
    )
    table["range"] = {"lowest": swept.drive.min(), "highest": swept.drive.max()}
    usual = float(np.median(swept.drive))
    for name, known in (("as measured", True), ("as its median", False)):
        draw = partial(swept.measured, known=known)
        fits, took = fit_draws(draw, range(100, 102 if quick else 120), base_amplitude=usual)
        rows = [numbers(f) for f in fits]
        table[name] = {"summary": summary(rows, damping), "took": took, "fits": rows}
        print(name, json.dumps(table[name]["summary"]), flush=True)
    return table


def whole_curve(quick: bool) -> dict[str, Any]:
    """Fit points along the whole branch: complex, their amplitudes, and the stable of these."""
    damping, table = DAMPINGS[1], {"curves": {}}
    held = excitation.Held.along(0.9, 1.32, 60, stiffness=STIFFNESS, damping=damping)
    table["points"] = {"all": len(held.stable), "unstable": int(np.sum(~held.stable))}
    for name in ("complex", "amplitudes", "stable"):
        draw = partial(held.measured, kind=name)
        fits, took = fit_draws(draw, range(100, 102 if quick else 120))
        rows = [numbers(f) for f in fits]
        table[name] = {"summary": summary(rows, damping), "took": took, "fits": rows}
        table["curves"][name] = curve_of(fits[0])
        print(name, json.dumps(table[name]["summary"]), flush=True)
    return table


PARTS: dict[str, Callable[[bool], dict[str, Any]]] = {
    "recovery": recovery,
    "coverage": coverage,
    "early_jump": early_jump,
    "model_error": model_error,
    "gaps": gaps,
    "free_gap": free_gap,
    "drive": drive,
    "whole_curve": whole_curve,
}


def save(folder: Path, part: str, found: dict[str, Any]) -> None:
    """Put the numbers of a part into `results.json`, and its curves into `curves.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    curves = found.pop("curves", None)
    for name, values in (("results.json", found), ("curves.json", curves)):
        if values is None:
            continue
        path = folder / name
        table = json.loads(path.read_text()) if path.exists() else {}
        table[part] = values
        lines = []
        for key in (k for k in PARTS if k in table):
            inner = ",\n".join(
                f"  {json.dumps(k)}: {json.dumps(short(v))}" for k, v in table[key].items()
            )
            lines.append(f"{json.dumps(key)}: {{\n{inner}\n}}")
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def short(value: Any) -> Any:
    """Round to six digits."""
    if isinstance(value, dict):
        return {k: short(v) for k, v in value.items()}
    if isinstance(value, list):
        return [short(v) for v in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def run(folder: Path, parts: Sequence[str] = tuple(PARTS), quick: bool = False) -> None:
    """Run the parts, and write their numbers and pictures into the folder."""
    for part in parts:
        found, took = timed(lambda part=part: PARTS[part](quick))
        save(folder, part, {**found, "took": took})
        print(f"{part}: {took}", flush=True)
    pictures.draw_all(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=list(PARTS), nargs="+", help="parts to run")
    parser.add_argument("--pictures", action="store_true", help="draw from what was saved")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--to", type=Path, default=HERE, help="folder to write into")
    asked = parser.parse_args()
    if asked.pictures:
        pictures.draw_all(asked.to)
    else:
        run(asked.to, asked.only or tuple(PARTS), asked.quick)


if __name__ == "__main__":
    main()
