"""The measures of a response as its branch's points give them: what a map or a table would.

Good to about a thousandth where peaks are round, and without derivatives: for the maps around the
designs.
"""

import itertools

import numpy as np


class OnBranch:
    """Stands for a `Response` in an objective."""

    def __init__(self, branch):
        self.branch = branch
        x, stable = branch.values, branch.stable
        rises = np.diff(x) > 0
        self.parts = []
        start = None
        for k in range(len(x)):
            goes_on = k + 1 < len(x) and stable[k] and stable[k + 1]
            if start is not None and (not goes_on or rises[k] != rises[start]):
                self.parts.append(np.arange(start, k + 1))
                start = None
            if goes_on and start is None:
                start = k

    def peak(self, variable="amplitude_ratio"):
        y = getattr(self.branch, variable)
        return max((float(y[part].max()) for part in self.parts), default=np.nan)

    def half_power_bandwidth(self, variable="amplitude_ratio"):
        level = self.peak(variable) / np.sqrt(2.0)
        x, y = self.branch.values, getattr(self.branch, variable) - level
        spans = []
        for part in self.parts:
            for a, b in itertools.pairwise(part):
                ends = sorted((x[a], x[b]))
                if y[a] * y[b] < 0:
                    zero = x[a] + (x[b] - x[a]) * y[a] / (y[a] - y[b])
                    ends = sorted((zero, x[a] if y[a] > 0 else x[b]))
                elif y[a] < 0:
                    continue
                spans.append(ends)
        spans.sort()
        total, reached = 0.0, -np.inf
        for low, high in spans:
            total += max(0.0, high - max(low, reached))
            reached = max(reached, high)
        return total

    def mean(self, variable):
        low, high = self.branch.range
        grid = np.linspace(low, high, 401)
        top = np.full(grid.shape, -np.inf)
        y = getattr(self.branch, variable)
        for part in self.parts:
            order = part[np.argsort(self.branch.values[part])]
            x = self.branch.values[order]
            inside = (grid >= x[0]) & (grid <= x[-1])
            top[inside] = np.maximum(top[inside], np.interp(grid[inside], x, y[order]))
        known = np.isfinite(top)
        return float(np.trapezoid(top[known], grid[known]) / (high - low))
