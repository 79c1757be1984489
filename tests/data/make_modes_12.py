"""Write modes_12.json: 12 modes by one power series about the root, in multiple precision.

Needs mpmath, which the tests do not: `pip install mpmath; python make_modes_12.py`.
"""

import json
from functools import cache
from itertools import zip_longest
from pathlib import Path

import mpmath as mp

mp.mp.dps = 70  # the series loses about e^beta and converges as taper^k
CASES = [(0.0, 0.0), (0.0, 10.0), (0.25, 0.3), (0.6, 2.0), (0.9, 0.0), (0.9, 10.0)]
POINTS = [0.1, 0.35, 0.6, 0.85, 0.97, 1.0]


def series(p, r, beta4, mu):
    """Coefficients of the solution with phi''(0) = 2p and phi'''(0) = 6r."""
    a = [mp.mpf(0), mp.mpf(0), mp.mpf(p), mp.mpf(r)]
    previous, k = mp.mpf(0), 0
    while k < 60 or max(abs(x) for x in a[-6:]) > mp.mpf(10) ** -60:
        a.append(
            mu * (k + 2) / mp.mpf(k + 4) * a[k + 3]
            + beta4 * (a[k] - mu * previous) / ((k + 4) * (k + 3) * (k + 2) * (k + 1))
        )
        previous, k = a[k], k + 1
    return a


def derivative(a, order):
    for _ in range(order):
        a = [k * c for k, c in enumerate(a)][1:]
    return a


def at(a, s):
    return mp.polyval(a[::-1], s)


def conditions(beta, mu, ratio):
    solutions = [series(1, 0, beta**4, mu), series(0, 1, beta**4, mu)]
    moment = [at(derivative(a, 2), 1) for a in solutions]
    shear = [at(derivative(a, 3), 1) + ratio * beta**4 / (1 - mu) * at(a, 1) for a in solutions]
    return solutions, moment, shear


def determinant(beta, mu, ratio):
    _, moment, shear = conditions(beta, mu, ratio)
    return (moment[0] * shear[1] - moment[1] * shear[0]) * mp.exp(-beta)


def roots(mu, ratio, count):
    found, beta, step = [], mp.mpf("0.05"), mp.mpf("0.25")
    left = determinant(beta, mu, ratio)
    while len(found) < count:
        right = determinant(beta + step, mu, ratio)
        if left * right < 0:
            found.append(
                mp.findroot(
                    lambda b: determinant(b, mu, ratio),
                    (beta, beta + step),
                    solver="anderson",
                    tol=mp.mpf(10) ** -80,
                    verify=False,
                )
            )
        beta, left = beta + step, right
    return found


@cache
def gauss(count=80):
    """Gauss-Legendre points and weights on [0, 1]."""
    rule = []
    for i in range(count):
        x = mp.cos(mp.pi * (i + 0.75) / (count + 0.5))
        for _ in range(9):
            before, value = mp.mpf(1), x
            for k in range(2, count + 1):
                before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
            slope = count * (before - x * value) / (1 - x**2)
            x -= value / slope
        rule.append(((1 + x) / 2, 1 / ((1 - x**2) * slope**2)))
    return rule


def case(mu, ratio, count=12):
    mu, ratio = mp.mpf(str(mu)), mp.mpf(str(ratio))
    betas, shapes, loads = roots(mu, ratio, count), [], []
    for beta in betas:
        solutions, moment, _ = conditions(beta, mu, ratio)
        both = zip_longest(*solutions, fillvalue=mp.mpf(0))
        a = [x - moment[0] / moment[1] * y for x, y in both]
        tip = at(a, 1)
        area = sum(w * (1 - mu * s) * at(a, s) ** 2 for s, w in gauss())
        scale = mp.sign(tip) / mp.sqrt(area + ratio * tip**2)
        shapes.append([float(scale * at(a, mp.mpf(str(s)))) for s in POINTS])
        load = sum(c / (k + 1) - mu * c / (k + 2) for k, c in enumerate(a))
        loads.append(float(scale * (load + ratio * tip)))
    return {
        "taper": float(mu),
        "mass_ratio": float(ratio),
        "beta": [float(b) for b in betas],
        "shape": shapes,
        "participation": loads,
    }


if __name__ == "__main__":
    answer = {
        "source": f"mpmath {mp.__version__}, {mp.mp.dps} digits, by make_modes_12.py; no JAX",
        "points_s": POINTS,
        "cases": [case(*numbers) for numbers in CASES],
    }
    Path(__file__).with_name("modes_12.json").write_text(json.dumps(answer, indent=1) + "\n")
