"""The measures of a response as settled curves of a map give them.

Good to the spacing of the frequencies, and without derivatives: for global searches, whose best
rigs are then evaluated exactly.
"""

import numpy as np


class Coarse:
    """Stands for a `Response` in an objective: the higher of the curves of both directions."""

    def __init__(self, lane, axis):
        self.frequency = lane[axis].values
        self.lane = lane

    def upper(self, variable):
        return self.lane[variable].max("direction").values

    def peak(self, variable="amplitude_ratio"):
        return float(np.nanmax(self.upper(variable)))

    def half_power_bandwidth(self, variable="amplitude_ratio"):
        x, y = self.frequency, self.upper(variable)
        y = y - np.nanmax(y) / np.sqrt(2.0)
        total = 0.0
        for a, b, low, high in zip(y[:-1], y[1:], x[:-1], x[1:], strict=True):
            if a > 0 and b > 0:
                total += high - low
            elif a > 0 or b > 0:
                total += (high - low) * max(a, b) / (max(a, b) - min(a, b))
        return total

    def mean(self, variable):
        x, y = self.frequency, self.upper(variable)
        return float(np.trapezoid(y, x) / (x[-1] - x[0]))
