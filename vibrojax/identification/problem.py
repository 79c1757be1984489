"""All data and all unknowns of an identification, as one least-squares problem."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from vibrojax.identification.coordinates import Coordinate


@runtime_checkable
class Misfit(Protocol):
    """Distance of one measurement from the model."""

    names: tuple[str, ...]
    """Arguments of the user's function it depends on."""

    @property
    def size(self) -> int:
        """How many residuals there are."""
        ...

    def residuals(
        self,
        values: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (lanes by size) and their derivatives (lanes by size by names)."""
        ...


class Part(NamedTuple):
    """One measurement: its misfit, and which unknown each of its arguments is."""

    misfit: Misfit
    unknowns: tuple[int, ...]


class Problem:
    """Least squares in the coordinates of the unknowns."""

    def __init__(self, parts: Sequence[Part], coordinates: Sequence[Coordinate]):
        self.parts, self.coordinates = tuple(parts), tuple(coordinates)

    @property
    def names(self) -> tuple[str, ...]:
        """The unknowns."""
        return tuple(c.name for c in self.coordinates)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the coordinates."""
        low, high = zip(*(c.limits for c in self.coordinates), strict=True)
        return np.array(low), np.array(high)

    def numbers(self, points: np.ndarray) -> np.ndarray:
        """Numbers at some points (lanes by unknowns)."""
        points = np.asarray(points)
        columns = [c.number(points[..., k]) for k, c in enumerate(self.coordinates)]
        return np.stack(columns, axis=-1)

    def point(self, numbers: Sequence[float] | np.ndarray) -> np.ndarray:
        """Coordinates of some numbers."""
        rows = zip(self.coordinates, np.asarray(numbers, float), strict=True)
        return np.array([float(c.inside(v)) for c, v in rows])

    def evaluate(
        self,
        points: np.ndarray,
        which: np.ndarray,
        frequency_scale: float,
        *,
        precisely: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives in the coordinates."""
        numbers = self.numbers(points)
        slopes = [c.slope(points[:, k]) for k, c in enumerate(self.coordinates)]
        residuals, jacobians = [], []
        for part in self.parts:
            index = np.array(part.unknowns)
            residual, derivative = part.misfit.residuals(
                numbers[:, index], which, frequency_scale, precisely=precisely
            )
            jacobian = np.zeros((*residual.shape, len(self.coordinates)))
            for column, k in enumerate(part.unknowns):
                jacobian[:, :, k] += derivative[:, :, column] * slopes[k][:, None]
            residuals.append(residual)
            jacobians.append(jacobian)
        return np.concatenate(residuals, axis=1), np.concatenate(jacobians, axis=1)
