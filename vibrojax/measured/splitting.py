"""Rows of a table divided by the values of some columns."""

from collections.abc import Iterator, Mapping

import numpy as np

from vibrojax.measured.columns import Unusable, raw_numbers, real_numbers
from vibrojax.measured.table import Table
from vibrojax.measured.units import UNITS, split_header, unit_named

Key = tuple[float | str, ...]


class Splitting:
    """Columns by whose values rows are divided: numbers in SI, or names."""

    def __init__(
        self,
        table: Table,
        columns: Mapping[str, str],
        units: Mapping[str, str],
        trouble: Unusable,
    ):
        import pandas

        self.values: list[list[float | str]] = []
        self._codes = np.zeros((len(columns), len(table.lines)), dtype=int)
        for k, (name, column) in enumerate(columns.items()):
            cells = table.columns[column]
            if np.isnan(raw_numbers(table, column, name)).all():  # names, not numbers
                texts = np.array([str(cell).strip() for cell in cells], dtype=object)
                self._codes[k], different = pandas.factorize(texts)
                self.values.append([str(text) for text in different])
                continue
            found = real_numbers(table, column, name, trouble)
            self._codes[k], different = pandas.factorize(found)
            text = units.get(name)
            if text is None and name != column:
                text = split_header(column).unit
            kinds = {unit.kind for unit in UNITS.values()}
            factor = 1.0 if text is None else UNITS[unit_named(name, text, kinds)].factor
            # Rounded, so that 0.4 mm is 0.0004 m.
            self.values.append(
                [float(f"{v * factor:.12g}") if text else float(v) for v in different]
            )

    def parts(self, keep: np.ndarray) -> Iterator[tuple[Key, np.ndarray]]:
        """Yield the values and rows of every part, in the order in which they begin."""
        import pandas

        rows = np.flatnonzero(keep)
        combined = np.zeros(len(rows), dtype=int)
        for codes, values in zip(self._codes, self.values, strict=True):
            combined = combined * len(values) + codes[rows]
        codes, different = pandas.factorize(combined)
        ends = np.cumsum(np.bincount(codes, minlength=len(different)))[:-1]
        for part in np.split(rows[np.argsort(codes, kind="stable")], ends):
            own = zip(self._codes[:, part[0]], self.values, strict=True)
            yield tuple(values[code] for code, values in own), part
