"""What the functions of a design say about rigs, whatever computes it."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Evaluation(NamedTuple):
    """What the functions say about one rig."""

    values: Float[np.ndarray, " functions"]
    """NaN where a function has no value: the note says why."""
    slopes: Float[np.ndarray, "functions numbers"]
    """Derivatives in the numbers; NaN where they were not asked for or are not known."""
    note: str = ""
    """Why something is missing, in a sentence; empty where nothing is."""


class AbstractEvaluator(ABC):
    """Functions of a rig's response, as functions of the numbers that the rig is made of."""

    names: tuple[str, ...]
    """Numbers that places consist of, in order."""
    functions: tuple[str, ...]
    """Names of the functions, in order of `values`."""

    @abstractmethod
    def evaluate(
        self, places: Float[np.ndarray, "rigs numbers"], *, slopes: bool = True
    ) -> list[Evaluation]:
        """Evaluate all functions for some rigs, side by side.

        `places` has a row of numbers for each rig; `slopes` says whether derivatives are wanted.
        Where one rig has no answer, its evaluation says so and the others are as without it.
        """
