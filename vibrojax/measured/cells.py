"""Cells of measurements as numbers: text with decimal points or commas, complex numbers."""

import numbers
import re
import reprlib
from typing import Any

import numpy as np

DECIMALS = (".", ",")
_EXPONENT = r"(?:[eE][+-]?\d+)?"


def _cell(pattern: str) -> re.Pattern[str]:
    """A pattern of whole cells, in text with a cell on every line."""
    return re.compile(rf"^[ \t]*[+-]?(?:{pattern})[ \t]*$", re.MULTILINE)


def _patterns(point: str, group: str) -> tuple[re.Pattern[str], re.Pattern[str], re.Pattern[str]]:
    """Patterns of one decimal sign and the other sign between thousands.

    Cells that are numbers with this decimal sign only; cells that are with either; and in cells of
    this decimal sign the part before it, in groups of thousands.
    """
    point, group = re.escape(point), re.escape(group)
    either = rf"[1-9]\d{{0,2}}{point}\d{{3}}"
    groups = rf"[1-9]\d{{0,2}}(?:{group}\d{{3}})"
    only = (
        rf"{groups}+{point}\d*|{groups}{{2,}}|(?!{either}[ \t]*$)(?:\d+{point}\d*|{point}\d+)"
        rf"{_EXPONENT}"
    )
    grouped = re.compile(rf"^[ \t]*[+-]?{groups}+(?={point}|[ \t]*$)", re.MULTILINE)
    return _cell(only), _cell(either), grouped


_OF_POINT = {".": _patterns(".", ","), ",": _patterns(",", ".")}


def decimal_signs(text: str) -> str | None:
    """Return the decimal signs that cells, one on each line, leave no doubt of.

    None where no cell has a comma. `5,400` may be 5.4 or 5400; `0,25`, `5,43`, `1.234,5` and
    `1.234.567` have decimal commas.
    """
    if "," not in text:
        return None
    # Whether a point can be found at all is known sooner than where.
    possible = "," if "." not in text and not re.search(r",\d{3},\d{3}", text) else ".,"
    return "".join(sign for sign in possible if _OF_POINT[sign][0].search(text))


def joined(cells: np.ndarray) -> str:
    """Return the cells of text, one on each line; an empty one in place of any other."""
    return "\n".join(cell if isinstance(cell, str) else "" for cell in cells.tolist())


def sign_of(text: str, of_file: str) -> str:
    """Return the decimal sign of the cells of a column, both where it has both; else none.

    Its own cells decide, or the decimal commas of the file. A point in other columns does not
    make `5,400` 5400: columns come from several programs.
    """
    own = decimal_signs(text)
    return own or ("," if of_file == "," else "." if own is None and "," not in of_file else "")


def doubtful(text: str, sign: str) -> str | None:
    """Return a cell that `sign` does not settle; None where there is none."""
    found = [_OF_POINT[s][1].search(text) for s in DECIMALS if len(sign) != 1]
    return next((match[0].strip() for match in found if match), None)


def with_points(cells: np.ndarray, sign: str) -> np.ndarray:
    """Return cells of text with decimal points and nothing between thousands.

    With both signs every cell has its own. Cells that a sign does not fit become no numbers.
    """
    text = joined(cells)
    if sign == ".,":
        own = [
            _pointed(line, "," if _OF_POINT[","][0].search(line) else ".")
            for line in text.split("\n")
        ]
    else:
        own = _pointed(text, sign or ".").split("\n")
    pairs = zip(cells.tolist(), own, strict=True)
    return np.array([new if isinstance(old, str) else old for old, new in pairs], dtype=object)


def _pointed(text: str, sign: str) -> str:
    group = "," if sign == "." else "."
    if group in text:
        text = _OF_POINT[sign][2].sub(lambda match: match[0].replace(group, ""), text)
    return text if sign == "." else text.replace(".", "?").replace(",", ".")


def number_in(cell: Any) -> float | complex | None:
    """Return the number of a cell, `1+2j` and `1 + 2i` too; None when there is none."""
    if isinstance(cell, str | bytes):
        text = cell.decode("latin-1") if isinstance(cell, bytes) else cell
        try:
            return float(text)
        except ValueError:
            return _complex_in(text)
    if isinstance(cell, bool | np.bool_ | np.timedelta64) or not isinstance(cell, numbers.Number):
        return None
    try:
        return complex(cell) if isinstance(cell, complex | np.complexfloating) else float(cell)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return None


def _complex_in(text: str) -> complex | None:
    plain = text.replace(" ", "").strip("()")
    if plain[-1:] not in ("i", "j", "I", "J") or not re.search(r"\d", plain):
        return None
    try:
        return complex(f"{plain[:-1]}j")
    except ValueError:
        return None


def numbers_in(cells: np.ndarray) -> np.ndarray:
    """Return the numbers of cells, complex where one of them is; NaN where there is none.

    Raises `ValueError` for dates and durations.
    """
    kind, parts = cells.dtype.kind, cells.dtype.names
    if kind in "mM":
        raise ValueError("holds dates or durations: give numbers, such as seconds since the start")
    if kind in "fiu":
        return cells.astype(float)
    if kind == "c":
        return cells.astype(complex)
    if kind == "V" and parts is not None and set(parts) == {"r", "i"}:  # as HDF5 has them
        return cells["r"] + 1j * cells["i"]
    listed = ["nan" if cell is None or cell == "" else cell for cell in cells.tolist()]
    if set(map(type, listed)) <= {str, float}:
        try:
            return np.fromiter(map(float, listed), float, len(listed))
        except ValueError:
            pass
    found = [number_in(cell) for cell in listed]
    kind = complex if any(isinstance(number, complex) for number in found) else float
    return np.array([np.nan if number is None else number for number in found], dtype=kind)


def is_empty(cells: np.ndarray) -> np.ndarray:
    """Return where cells are empty: without text, or NaN."""
    if cells.dtype.kind in "fc":
        return np.isnan(cells)
    if cells.dtype.kind not in "OUT":
        return np.zeros(len(cells), dtype=bool)
    return np.array([_is_nothing(cell) for cell in cells.tolist()], dtype=bool)


def _is_nothing(cell: Any) -> bool:
    if isinstance(cell, str):
        return cell.strip().lower() in ("", "nan")
    return cell is None or (isinstance(cell, float) and cell != cell)


def plain_array(values: Any) -> np.ndarray:
    """Return anything array-like as an array; what is masked becomes NaN."""
    if isinstance(values, np.ma.MaskedArray):
        return np.ma.filled(values.astype(np.result_type(values.dtype, float)), np.nan)
    return np.asarray(values)


def channel(name: str, values: Any) -> np.ndarray:
    """Return a sequence of numbers as an array, complex where they are.

    Raises `ValueError` for anything else.
    """
    try:
        array = plain_array(values)
        if array.ndim != 1:
            raise ValueError(f"an array of shape {array.shape}")
        if array.dtype.kind not in "fiuc" and any(number_in(c) is None for c in array.tolist()):
            raise ValueError(reprlib.repr(array.tolist()))
        return np.array(numbers_in(array))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} must be a one-dimensional sequence of numbers, got {error}."
        ) from None


def real_channel(name: str, values: Any) -> np.ndarray:
    """Return a sequence of real numbers as an array. Raises `ValueError` for anything else."""
    found = channel(name, values)
    if not np.iscomplexobj(found):
        return found
    if np.any(np.imag(found) != 0):
        first = found[np.flatnonzero(np.imag(found) != 0)[0]]
        raise ValueError(f"{name} must be real, got the complex number {first:g}.")
    return np.real(found)
