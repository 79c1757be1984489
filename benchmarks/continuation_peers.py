"""One frequency response curve with both its folds, followed by other programs.

    taskset -c 0 python benchmarks/continuation_peers.py [--json FILE] [--only AUTO ...]

The curve is the period-1 motion of the default rig with 5 modes from frequency ratio 0.85 to 1.31
(to the first natural frequency), along the branch: up to the fold at 1.226736, back to the fold at
1.096507 and on. A peer's error is that of the two folds it reports. The peers, each left out with
the reason where it is missing:

- **AUTO-07p**: orthogonal collocation and pseudo-arclength. `apt-get install auto-07p gfortran` on
  Debian and Ubuntu, or any build of AUTO that puts `auto` on the path (or sets AUTO_DIR).
- **NLvib** (Krack and Gross) under Octave: harmonic balance with alternating frequency and time.
  `apt-get install octave`, clone github.com/maltekrack/NLvib, and set NLVIB_PATH to the clone.
- **scipy**: no continuation. Sweeps up and down in steps of 0.01 until the motion settles, as a lab
  script does; it comes with this package. Its folds are the jumps, so at best to half a step.

All work on one scaled model: time in 1 / w_1, displacement at the stop in gaps.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import exact_propagation as exact
import numpy as np
from exact_propagation import Problem

FIRST_RATIO, LAST_RATIO = 0.85, 1.31
EXACT_FOLDS = (1.226736, 1.096507)  # given, not computed here; AUTO agrees to some 1e-5


@dataclass(frozen=True)
class Curve:
    """What a peer needed for the curve and where it found the folds, as frequency ratios.

    `seconds` is without compiling and without starting an interpreter; `points` counts accepted
    points of the branch (for scipy, of both sweeps).
    """

    name: str
    version: str
    seconds: float
    compile_seconds: float
    points: int
    folds: tuple[float, ...]
    settings: dict = field(default_factory=dict)

    @property
    def errors(self) -> tuple[float, ...]:
        """Distance of each fold from the exact one; none where their number is wrong."""
        if len(self.folds) != len(EXACT_FOLDS):
            return ()
        return tuple(abs(a - b) for a, b in zip(self.folds, EXACT_FOLDS, strict=True))


@dataclass(frozen=True)
class Missing:
    """A peer that did not run, and why."""

    name: str
    reason: str


class _Gaps:
    """The model in z_i = side phi_i(s1) q_i / gap and p_i = z_i' / r_i, time in 1 / w_1.

    z_i' = r_i p_i,  p_i' = -r_i z_i - 2 zeta_i r_i p_i + drive_i rho^2 sin(rho t) - push_i f,
    f = d + loss d' where d = sum z_i - 1 > 0. `rho` is the frequency ratio.
    """

    def __init__(self, problem: Problem):
        if not problem.tension:
            raise ValueError("the peers take the contact law that may pull")
        w = np.asarray(problem.angular_frequency, float)
        shape = problem.side * np.asarray(problem.shape_at_stop, float)
        self.ratio = w / w[0]
        self.zeta = np.broadcast_to(problem.damping_ratio, w.shape).astype(float)
        self.amplitude = (
            np.asarray(problem.participation) * problem.base_amplitude * shape / problem.gap
        )
        self.mobility = problem.stiffness * shape**2 / np.asarray(problem.modal_mass) / w[0] ** 2
        self.drive, self.push = self.amplitude / self.ratio, self.mobility / self.ratio
        self.loss = problem.damping * w[0] / problem.stiffness

    def linear_response(self, rho: float) -> np.ndarray:
        """Complex Z of the motion without contact, z = Im Z exp(i rho t)."""
        r, zeta = self.ratio, self.zeta
        return self.amplitude * rho**2 / (r**2 - rho**2 + 2j * zeta * r * rho)


def _turning_points(ratios: np.ndarray, along: np.ndarray | None = None) -> tuple[float, ...]:
    """Ratios at which the branch turns, wiggles below 1e-3 left out.

    With `along`, an amplitude that grows or falls monotonically through the fold, each is the
    vertex of the parabola through the outermost point and its neighbours.
    """
    folds, sign, best = [], 1.0, 0
    for i, ratio in enumerate(ratios):
        if sign * (ratio - ratios[best]) > 0.0:
            best = i
        elif sign * (ratios[best] - ratio) > 1e-3:
            folds.append(best)
            sign, best = -sign, i
    if along is None:
        return tuple(float(ratios[i]) for i in folds)
    refined = []
    for i in folds:
        a, b, c = np.polyfit(along[i - 1 : i + 2] - along[i], ratios[i - 1 : i + 2], 2)
        refined.append(float(c - b * b / (4.0 * a)))
    return tuple(refined)


def _first_line(command: list[str]) -> str:
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    return (answer.stdout.splitlines() or [""])[0].strip()


# ---------------------------------------------------------------------------------------- AUTO-07p

_AUTO_EQUATIONS = """\
module rig
  implicit none
  integer, parameter :: dp = kind(1.0d0), n = {n}
  real(dp), parameter :: r(n) = [{ratio}]
  real(dp), parameter :: zeta(n) = [{zeta}]
  real(dp), parameter :: drive(n) = [{drive}]
  real(dp), parameter :: push(n) = [{push}]
  real(dp), parameter :: start_cos(2 * n) = [{start_cos}]
  real(dp), parameter :: start_sin(2 * n) = [{start_sin}]
  real(dp), parameter :: loss = {loss}, width = {width}
  real(dp), parameter :: two_pi = 6.283185307179586476925286766559_dp
contains
  ! The force, its slopes in depth and rate: a ramp whose corner is a quartic over +-width.
  subroutine contact(depth, rate, force, by_depth, by_rate)
    real(dp), intent(in) :: depth, rate
    real(dp), intent(out) :: force, by_depth, by_rate
    real(dp) :: s, step, slope
    s = min(1.0_dp, max(0.0_dp, (depth + width) / (2 * width)))
    step = s**2 * (3 - 2 * s)
    slope = 6 * s * (1 - s) / (2 * width)
    force = 2 * width * s**3 * (1 - s / 2) + max(0.0_dp, depth - width) + loss * step * rate
    by_depth = step + loss * slope * rate
    by_rate = loss * step
  end subroutine contact
end module rig

subroutine func(ndim, u, icp, par, ijac, f, dfdu, dfdp)
  use rig
  implicit none
  integer, intent(in) :: ndim, icp(*), ijac
  real(dp), intent(in) :: u(ndim), par(*)
  real(dp), intent(out) :: f(ndim)
  real(dp), intent(inout) :: dfdu(ndim, ndim), dfdp(ndim, *)
  real(dp) :: rho, period, base, force, by_depth, by_rate
  integer :: i, j
  rho = par(1)
  period = two_pi / rho
  base = rho**2 * sin(two_pi * u(2 * n + 1))
  call contact(sum(u(1:n)) - 1, sum(r * u(n + 1:2 * n)), force, by_depth, by_rate)
  f(1:n) = period * r * u(n + 1:2 * n)
  f(n + 1:2 * n) = period * (-r * u(1:n) - 2 * zeta * r * u(n + 1:2 * n) + drive * base &
    - push * force)
  f(2 * n + 1) = 1
  if (ijac == 0) return
  dfdu = 0
  do j = 1, n
    do i = 1, n
      dfdu(n + i, j) = -period * push(i) * by_depth
      dfdu(n + i, n + j) = -period * push(i) * by_rate * r(j)
    end do
    dfdu(j, n + j) = period * r(j)
    dfdu(n + j, j) = dfdu(n + j, j) - period * r(j)
    dfdu(n + j, n + j) = dfdu(n + j, n + j) - period * 2 * zeta(j) * r(j)
    dfdu(n + j, 2 * n + 1) = two_pi * rho * drive(j) * two_pi * cos(two_pi * u(2 * n + 1))
  end do
  if (ijac == 1) return
  dfdp(1:ndim, 1) = -f(1:ndim) / rho
  dfdp(n + 1:2 * n, 1) = dfdp(n + 1:2 * n, 1) + period * drive * 2 * base / rho
  dfdp(2 * n + 1, 1) = 0
end subroutine func

subroutine stpnt(ndim, u, par, t)
  use rig
  implicit none
  integer, intent(in) :: ndim
  real(dp), intent(inout) :: u(ndim), par(*)
  real(dp), intent(in) :: t
  par(1) = {first_ratio}
  u(1:2 * n) = start_cos * cos(two_pi * t) + start_sin * sin(two_pi * t)
  u(2 * n + 1) = t
end subroutine stpnt

subroutine bcnd(ndim, par, icp, nbc, u0, u1, fb, ijac, dbc)
  use rig
  implicit none
  integer, intent(in) :: ndim, icp(*), nbc, ijac
  real(dp), intent(in) :: par(*), u0(ndim), u1(ndim)
  real(dp), intent(out) :: fb(nbc)
  real(dp), intent(inout) :: dbc(nbc, *)
  integer :: i
  fb(1:2 * n) = u0(1:2 * n) - u1(1:2 * n)
  fb(2 * n + 1) = u0(2 * n + 1)
  if (ijac == 0) return
  dbc(1:nbc, 1:2 * ndim) = 0
  do i = 1, 2 * n
    dbc(i, i) = 1
    dbc(i, ndim + i) = -1
  end do
  dbc(2 * n + 1, 2 * n + 1) = 1
  if (ijac == 2) dbc(1:nbc, 2 * ndim + 1) = 0
end subroutine bcnd

subroutine icnd
end subroutine icnd

subroutine fopt
end subroutine fopt

subroutine pvls
end subroutine pvls
"""

_AUTO_CONSTANTS = """\
NDIM = {ndim}, IPS = 4, IRS = 0, ILP = 1
ICP = [1]
NTST = {ntst}, NCOL = {ncol}, IAD = {iad}, ISP = 0, ISW = 1, IPLT = 0, NBC = {ndim}, NINT = 0
NMX = 4000, NPR = 100000, MXBF = 0, IID = 0, ITMX = 8, ITNW = 6, NWTN = {nwtn}, JAC = 1
EPSL = {eps}, EPSU = {eps}, EPSS = {epss}
DS = {ds}, DSMIN = 1e-6, DSMAX = {dsmax}, IADS = 1
NPAR = 1, THL = {{}}, THU = {{{ndim}: 0.0}}
UZSTOP = {{1: [{last_ratio}]}}
"""

AUTO_SETTINGS = {
    "width": 3e-3,  # of the rounded corner, in gaps
    "ntst": 60,
    "ncol": 4,
    "iad": 3,
    "nwtn": 3,
    "eps": 1e-6,
    "epss": 1e-5,
    "ds": 0.02,
    "dsmax": 0.5,
}
AUTO_COARSE = {"ntst": 40, "ncol": 3}


def _auto_folder() -> Path | None:
    """The folder of AUTO's objects: AUTO_DIR, or what the program on the path belongs to."""
    candidates = [Path(os.environ["AUTO_DIR"])] if os.environ.get("AUTO_DIR") else []
    for program in ("auto-07p", "auto"):
        found = shutil.which(program)
        if found:
            prefix = Path(found).resolve().parent.parent
            candidates += [prefix, prefix / "lib" / "auto-07p"]
    for folder in candidates:
        if (folder / "lib" / "bvp.o").exists():
            return folder
    return None


def _auto_version() -> str:
    """Of the Debian package where there is one: AUTO's programs do not give theirs."""
    if shutil.which("dpkg-query") is None:
        return "07p"
    packaged = _first_line(["dpkg-query", "-W", "-f", "${Version}", "auto-07p"])
    return packaged or "07p"


def _fortran(values) -> str:
    """Numbers of an array constructor, one a line to keep within Fortran's line length."""
    return ", &\n    ".join(f"{float(v):.17e}".replace("e", "d") for v in np.atleast_1d(values))


def run_auto(problem: Problem, **changed) -> Curve | Missing:
    """AUTO-07p: collocation on an adapted mesh, the drive phase an extra state.

    The corner of the force is rounded, which moves the lower fold by 3e-5 at this width.
    The folds are the outermost points of the branch; AUTO's located ones (LP) are among them, but
    it also labels the wiggles that moving its mesh makes.
    """
    name = "AUTO-07p"
    folder = _auto_folder()
    if folder is None:
        return Missing(name, "not installed: neither auto-07p on the path nor AUTO_DIR set")
    if shutil.which("gfortran") is None:
        return Missing(name, "gfortran is not installed")
    settings = AUTO_SETTINGS | changed
    model = _Gaps(problem)
    n = problem.num_modes
    response = model.linear_response(FIRST_RATIO)
    both = np.concatenate([response, 1j * FIRST_RATIO * response / model.ratio])
    source = _AUTO_EQUATIONS.format(
        n=n,
        ratio=_fortran(model.ratio),
        zeta=_fortran(model.zeta),
        drive=_fortran(model.drive),
        push=_fortran(model.push),
        start_cos=_fortran(both.imag),
        start_sin=_fortran(both.real),
        loss=_fortran(model.loss),
        width=_fortran(settings["width"]),
        first_ratio=_fortran(FIRST_RATIO),
    )
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        (here / "rig.f90").write_text(source)
        constants = {k: v for k, v in settings.items() if k != "width"}
        (here / "fort.2").write_text(
            _AUTO_CONSTANTS.format(ndim=2 * n + 1, last_ratio=LAST_RATIO, **constants)
        )
        objects = sorted(str(path) for path in (folder / "lib").glob("*.o"))
        compiler = ["gfortran", "-O3", "-fopenmp", "rig.f90", *objects, "-o", "rig"]
        began = time.perf_counter()
        subprocess.run(compiler, cwd=here, check=True, capture_output=True)
        compile_seconds = time.perf_counter() - began
        began = time.perf_counter()
        subprocess.run(
            ["./rig"],
            cwd=here,
            check=True,
            capture_output=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        seconds = time.perf_counter() - began
        rows = [line.split() for line in (here / "fort.7").read_text().splitlines()]
    rows = [row for row in rows if row and row[0] != "0"]  # not the headings
    folds = _turning_points(np.array([float(row[4]) for row in rows]))
    return Curve(name, _auto_version(), seconds, compile_seconds, len(rows), folds, settings)


# ------------------------------------------------------------------------------------------- NLvib

_NLVIB_SCRIPT = """\
1;
function [R, dR] = residual(X, rig, load, H, N)
  % HB_residual for a base that shakes: the excitation grows with the frequency squared.
  rig.Fex1 = load * X(end)^2;
  [R, dR] = HB_residual(X, rig, H, N, 'FRF');
  n = length(load);
  dR(n + (1:n), end) = dR(n + (1:n), end) - 2 * load * X(end);
end
addpath(fullfile(getenv('NLVIB_PATH'), 'SRC'));
addpath(fullfile(getenv('NLVIB_PATH'), 'SRC', 'MechanicalSystems'));
H = {harmonics}; N = {samples};
r = [{ratio}]; zeta = [{zeta}]; load = [{load}]; direction = [{direction}];
stop = struct('type', 'unilateralSpring', 'stiffness', 1, 'gap', 1, 'force_direction', direction);
rig = MechanicalSystem(eye({n}), diag(2 * zeta .* r), diag(r.^2), stop, load * {first}^2);
linear = (rig.K + 1i * {first} * rig.D - {first}^2 * rig.M) \\ rig.Fex1;
start = zeros((2 * H + 1) * {n}, 1);
start({n} + (1:2 * {n})) = [real(linear); -imag(linear)];
options = struct('Dscale', [{scale} * ones(size(start)); 1], 'dsmax', {dsmax}, ...
  'dsmin', 1e-6, 'stepmax', 5000, 'parametrization', '{parametrization}', 'eps', {eps});
solver = optimset('Display', 'off', 'Jacobian', 'on', 'MaxIter', {iterations}, ...
  'Updating', 'off', 'TolFun', {eps}, 'TolX', {eps});
began = tic;
[X, info] = solve_and_continue(start, @(X) residual(X, rig, load, H, N), {first}, {last}, ...
  {ds}, options, {{}}, solver);
seconds = toc(began);
fid = fopen('curve.txt', 'w');
fprintf(fid, '%.17g %d\\n', seconds, sum(info.FC));
fprintf(fid, '%.17g %.17g\\n', [X(end, :); hypot(X({n} + 1, :), X(2 * {n} + 1, :))]);
fclose(fid);
"""

NLVIB_SETTINGS = {
    "harmonics": 15,
    "samples": 512,
    "ds": 0.02,
    "dsmax": 0.03,
    "scale": 1.0,
    "parametrization": "orthogonal",
    "iterations": 20,
    "eps": 1e-5,
}
NLVIB_FINE = {"harmonics": 25, "dsmax": 0.01}


def _octave(values) -> str:
    return "; ".join(f"{float(v):.17g}" for v in np.atleast_1d(values))


def _nlvib_version() -> str:
    text = (Path(os.environ["NLVIB_PATH"]) / "SRC" / "solve_and_continue.m").read_text("latin-1")
    found = re.search(r"NLvib Version ([\d.]+)", text)
    octave = _first_line(["octave-cli", "--version"]).rpartition(" ")[2]
    return f"{found[1] if found else 'unknown'}, Octave {octave}"


def run_nlvib(problem: Problem, **changed) -> Curve | Missing:
    """NLvib under Octave: harmonic balance, in mass-normalised modes.

    Its unilateral spring has no damper, so the contact damping, 5e-5 N s/m here, is left out.
    With 10 harmonics the branch grows folds that are not there. The lower fold, a sharp corner,
    scatters with where the points fall: up to 4e-3 off at dsmax 0.05 to 0.1, 1e-3 at 0.02 to 0.03.
    """
    name = "NLvib"
    if not os.environ.get("NLVIB_PATH"):
        return Missing(name, "NLVIB_PATH, the folder of a clone of NLvib, is not set")
    octave = shutil.which("octave-cli")
    if octave is None:
        return Missing(name, "octave-cli is not installed")
    settings = NLVIB_SETTINGS | changed
    model = _Gaps(problem)
    direction = np.sqrt(model.mobility)
    script = _NLVIB_SCRIPT.format(
        n=problem.num_modes,
        ratio=_octave(model.ratio),
        zeta=_octave(model.zeta),
        load=_octave(model.amplitude / direction),
        direction=_octave(direction),
        first=FIRST_RATIO,
        last=LAST_RATIO,
        **settings,
    )
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        (here / "sweep.m").write_text(script)
        answer = subprocess.run(
            [octave, "--quiet", "--norc", "sweep.m"],
            cwd=here,
            check=False,
            capture_output=True,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        if not (here / "curve.txt").exists():
            return Missing(name, "failed: " + answer.stderr.strip()[-200:])
        lines = np.loadtxt((here / "curve.txt").read_text().splitlines())
    seconds, (ratios, amplitude) = float(lines[0, 0]), lines[1:].T
    folds = _turning_points(ratios, amplitude)
    return Curve(name, _nlvib_version(), seconds, 0.0, len(ratios), folds, settings)


# ------------------------------------------------------------------------------------------- scipy

SCIPY_SETTINGS = {
    "step": 0.01,  # in frequency ratio
    "tolerance": 1e-6,
    "settled": 1e-4,  # largest change of the state over one period, relative to its largest entry
    "most_periods": 500,
    "periods_at_once": 10,
    "samples": 32,  # a period
}


def run_scipy(problem: Problem, **changed) -> Curve:
    """scipy's LSODA swept up and down, each ratio from the settled motion of the one before.

    `odeint` with the kinked force, no events, is twice as fast here as `solve_ivp` phase by phase.
    A fold is half-way between the two ratios with the largest change of amplitude between them.
    """
    import scipy
    from scipy.integrate import odeint

    settings = SCIPY_SETTINGS | changed
    model, n = _Gaps(problem), problem.num_modes
    r, zeros = model.ratio, np.zeros(problem.num_modes)
    free = np.block([[np.zeros((n, n)), np.diag(r)], [-np.diag(r), -np.diag(2.0 * model.zeta * r)]])
    depth = np.concatenate([np.ones(n), zeros])
    push, forcing = np.concatenate([zeros, model.push]), np.concatenate([zeros, model.drive])
    touching = free - np.outer(push, depth + model.loss * np.concatenate([zeros, r]))

    def rate(t, x, rho):
        base = forcing * (rho * rho * math.sin(rho * t))
        return touching @ x + (base + push) if depth @ x > 1.0 else free @ x + base

    def jacobian(t, x, rho):
        return touching if depth @ x > 1.0 else free

    samples, many = settings["samples"], settings["periods_at_once"]

    def settle(x, rho):
        """State after settling and the largest displacement at the stop over the last period."""
        period = 2.0 * math.pi / rho
        times = np.arange(many * samples + 1) * (period / samples)
        for _ in range(-(-settings["most_periods"] // many)):
            states = odeint(
                rate,
                x,
                times,
                args=(rho,),
                tfirst=True,
                Dfun=jacobian,
                rtol=settings["tolerance"],
                atol=settings["tolerance"],
                hmax=period / 50.0,
                mxstep=100_000,
            )
            x, before = states[-1], states[-1 - samples]
            if np.abs(x - before).max() < settings["settled"] * np.abs(x).max():
                break
        return x, (states[-samples:] @ depth).max()

    count = round((LAST_RATIO - FIRST_RATIO) / settings["step"])
    ratios = FIRST_RATIO + settings["step"] * np.arange(count + 1)
    began = time.perf_counter()
    folds, x = [], np.zeros(2 * n)
    for sweep in (ratios, ratios[::-1]):
        amplitude = []
        for rho in sweep:
            x, largest = settle(x, rho)
            amplitude.append(largest)
        jump = int(np.abs(np.diff(amplitude)).argmax())
        folds.append(float(sweep[jump] + sweep[jump + 1]) / 2.0)
    seconds = time.perf_counter() - began
    return Curve("scipy", scipy.__version__, seconds, 0.0, 2 * len(ratios), tuple(folds), settings)


# ------------------------------------------------------------------------------------------- table

RUNS = {
    "AUTO-07p": run_auto,
    "AUTO-07p coarse": functools.partial(run_auto, **AUTO_COARSE),
    "NLvib": run_nlvib,
    "NLvib fine": functools.partial(run_nlvib, **NLVIB_FINE),
    "scipy": run_scipy,
}


def measure(name: str, repeats: int) -> Curve | Missing:
    """The fastest of some runs; scipy, which takes a minute or two, runs once."""
    problem = exact.default_problem()
    runs = [RUNS[name](problem) for _ in range(1 if name == "scipy" else repeats)]
    curves = [run for run in runs if isinstance(run, Curve)]
    if len(curves) < len(runs):
        return replace(next(run for run in runs if isinstance(run, Missing)), name=name)
    return replace(min(curves, key=lambda run: run.seconds), name=name)


def _row(curve: Curve) -> str:
    folds = ", ".join(f"{fold:.5f}" for fold in curve.folds) or "none"
    errors = ", ".join(f"{error:.1e}" for error in curve.errors) or "-"
    return (
        f"| {curve.name} | {curve.version} | {curve.seconds:.2f} | {curve.compile_seconds:.2f} | "
        f"{curve.points} | {folds} | {errors} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="A curve with two folds, by other programs.")
    parser.add_argument("--json", type=Path, help="write the results here as well")
    parser.add_argument("--only", nargs="*", default=list(RUNS), choices=list(RUNS))
    parser.add_argument("--repeats", type=int, default=3, help="the fastest one counts")
    options = parser.parse_args()
    print("| program | version | run [s] | compile [s] | points | folds | errors |")
    print("|---|---|---|---|---|---|---|")
    results = [measure(name, options.repeats) for name in options.only]
    for result in results:
        if isinstance(result, Curve):
            print(_row(result))
    for result in results:
        if isinstance(result, Missing):
            print(f"{result.name} left out: {result.reason}")
    if options.json:
        rows = [
            asdict(result) | ({"errors": result.errors} if isinstance(result, Curve) else {})
            for result in results
        ]
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
