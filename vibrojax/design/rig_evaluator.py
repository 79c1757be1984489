"""Functions of rigs' responses, evaluated for many rigs side by side."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_names, check_needed_arguments
from vibrojax._tools.described import recipe
from vibrojax._tools.gathered import gathered
from vibrojax.branches.along import check_continued
from vibrojax.branches.branch import Branch
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.work import follow_branches
from vibrojax.design.around import paths_with_slopes
from vibrojax.design.evaluation import AbstractEvaluator, Evaluation
from vibrojax.design.group import Ask, RigGroup
from vibrojax.design.known_branch import KnownBranch
from vibrojax.design.measures import NoSuchPlace
from vibrojax.design.response import Response
from vibrojax.ensemble.arguments import numbers_apart
from vibrojax.ensemble.lanes import made_by
from vibrojax.ensemble.ranges import Range
from vibrojax.ensemble.slopes import systems_with_slopes
from vibrojax.model.systems import AbstractSystem
from vibrojax.steady.batches import filled_up
from vibrojax.stepping.choice import is_exact
from vibrojax.stepping.contact_phases import can_resonate, phases_of

WIDTHS = 1, 8, 64
"""Rigs made and followed together: the least of these that holds them all."""


class RigEvaluator(AbstractEvaluator):
    """Functions of the response of a rig, as functions of the numbers that it is made of."""

    def __init__(
        self,
        make_system: Callable[..., AbstractSystem],
        functions: Mapping[str, Callable[[Response], Any]],
        names: Sequence[str],
        *,
        axis: str,
        range: Range,
        settings: ContinuationSettings,
        numbers: Mapping[str, Any],
    ):
        check_names(make_system, [*names, *numbers])
        check_needed_arguments(make_system, [*names, *numbers])
        self.make, self.names = make_system, tuple(names)
        self.functions = tuple(functions)
        self._functions = tuple(functions.values())
        self.axis, self.range, self.settings = axis, range, settings
        self.fixed, self.static = numbers_apart(numbers)

    def check(self, place: Sequence[float] | Float[np.ndarray, " numbers"]) -> AbstractSystem:
        """Build the rig of a place from concrete numbers, and refuse one that cannot be answered.

        Raises `ValueError`.
        """
        own = dict(zip(self.names, map(float, place), strict=True))
        system = made_by(self.make, self.static | self.fixed | own)
        if not is_exact(system):
            raise ValueError(
                "Designs need stops that are linear (KelvinVoigt without smoothing, "
                "StandardLinearSolid, MaxwellChain): the derivatives are those of exact motions."
            )
        check_continued(system)
        linear = system.equations().linear_between_contacts
        if linear is not None and can_resonate(phases_of(linear)):
            raise ValueError(
                "Designs need damping of every mode, in contact too (a ratio of 1e-4 or more): "
                "without, the response has no bound at resonance. Give the system a damping_ratio "
                "above 0, and stops of large stiffness a damping."
            )
        return system

    def response(self, place: Float[np.ndarray, " numbers"]) -> Response:
        """Follow the branch of one rig."""
        (found,) = self.responses(np.asarray(place, float)[None])
        return found

    def responses(self, places: Float[np.ndarray, "rigs numbers"]) -> list[Response]:
        """Follow the branches of some rigs, side by side."""
        found: list[Response] = []
        for first in range(0, len(places), WIDTHS[-1]):
            found += self._followed(places[first : first + WIDTHS[-1]])[1]
        return found

    def _followed(self, places: np.ndarray) -> tuple[RigGroup, list[Response]]:
        count, sample = len(places), self.check(places[0])
        width = next(w for w in WIDTHS if w >= count)
        rows = np.asarray(places, float)[filled_up(count, width)]
        numbers = {n: np.full(width, v) for n, v in self.fixed.items()}
        numbers |= {name: rows[:, k] for k, name in enumerate(self.names)}
        made = systems_with_slopes(self.make, self.static, self.names, numbers)
        values = [dict(zip(self.names, row, strict=True)) for row in rows[:count].tolist()]
        is_ratio = self.axis == "frequency_ratio"
        paths, slopes = jax.device_get(paths_with_slopes(*made, is_ratio))
        plan = self.settings.plan(
            sample,
            axis=self.axis,
            low=self.range.low,
            high=self.range.high,
            labels=values if count > 1 else [{}],  # how others differ from the rig described
            description=recipe(sample),
        )
        own, changes = (
            jax.tree.map(lambda a: np.asarray(a)[:count], tree) for tree in (paths, slopes)
        )
        branches = follow_branches(plan, own)
        group = RigGroup(own, changes, plan.period)
        frequency = own.equations.angular_frequency[:, 0] / 2 / np.pi
        rates = changes.equations.angular_frequency[:, :, 0] / 2 / np.pi
        found = []
        for k, points in enumerate(branches):
            known = KnownBranch(points, group, k, len(self.names))
            natural = float(frequency[k]), np.asarray(rates[k])
            found.append(Response(Branch.of(points), known, values[k], natural))
        return group, found

    def evaluate(
        self, places: Float[np.ndarray, "rigs numbers"], *, slopes: bool = True
    ) -> list[Evaluation]:
        """Evaluate all functions for some rigs, their branches followed side by side."""
        places, found = np.asarray(places, float), []
        for first in range(0, len(places), WIDTHS[-1]):
            group, responses = self._followed(places[first : first + WIDTHS[-1]])
            each = [partial(self._evaluated, response) for response in responses]
            found += [future.result() for future in gathered(each, group.answer)]
        return found

    def _evaluated(self, response: Response, ask: Ask) -> Evaluation:
        response.ask_of(ask)
        values = np.full(len(self._functions), np.nan)
        slopes = np.full((len(self._functions), len(self.names)), np.nan)
        branch, notes = response.branch, []
        if not branch.completed:
            return Evaluation(
                values, slopes, f"The branch was not followed to its end: {branch.sentence}"
            )
        for k, (name, function) in enumerate(zip(self.functions, self._functions, strict=True)):
            try:
                values[k], slopes[k] = response.differentiate(function)
            except NoSuchPlace as error:
                notes.append(f"{name}: {error}")
            else:
                if not np.isfinite(values[k]):
                    notes.append(f"{name} is {values[k]}.")
                elif not np.isfinite(slopes[k]).all():
                    notes.append(f"{name}: its derivatives are not known here.")
        return Evaluation(values, slopes, " ".join(notes))
