"""Text files of delimited cells: decoded, and split into columns."""

import codecs
import csv
import io
import re

import numpy as np

from vibrojax.measured.cells import decimal_signs, number_in
from vibrojax.measured.table import NoTable, Table, with_signs, with_units_row

_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_CONTROL = bytes([*range(9), *range(14, 32), 127])


def _decoded(raw: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16, UTF-32 or Latin-1.

    Raises `NoTable` for what is no text.
    """
    encoding = next((e for mark, e in _BYTE_ORDER_MARKS.items() if raw.startswith(mark)), None)
    encoding = encoding or _unmarked(raw[:4096])
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            raise NoTable(f"is not text: it begins as {encoding.upper()} but is not") from None
        text = raw.decode("latin-1")
    text = text.rstrip("\x1a")  # how DOS ended files
    plain = text.encode()
    if len(plain.translate(None, _CONTROL)) < len(plain):
        raise NoTable("is not text")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _unmarked(start: bytes) -> str:
    """Encoding of a file without a byte order mark, by where its zeros are."""
    even, odd = start[::2].count(0), start[1::2].count(0)
    if max(even, odd) > 0.2 * len(start) and not min(even, odd):
        return "utf-16-le" if odd else "utf-16-be"
    return "utf-8"


def _cells(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of one line."""
    if delimiter is None:
        line, delimiter = " ".join(line.split()), " "
    reader = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    try:
        return [cell.strip() for cell in next(reader, [])]
    except csv.Error as error:  # a cell of more than 131072 characters
        raise NoTable(f"is not a table: {error}") from None


def _header(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a header; where spaces part them, a unit belongs to the word before."""
    return _cells(re.sub(r"\s+(?=[\[(])", "", line) if delimiter is None else line, delimiter)


def read_text(raw: bytes, by_position: bool, decimal: str | None) -> Table:
    """Return the table of a text file, with a header unless columns are asked for by position.

    Cells are between semicolons, tabs, commas or spaces, whichever the first row has; `#` begins a
    comment. `decimal` is the decimal sign, None: from the cells. Columns are numbers, or cells of
    text, None where a line has too few. Raises `NoTable` for what is no such table.
    """
    first, comment, line, rest = _first_row(_decoded(raw))
    unquoted = re.sub(r'"[^"]*"', "", first)
    delimiter = next((d for d in (";", "\t", ",") if d in unquoted), None)
    header = _header(first, delimiter)
    if all(number_in(cell.replace(",", "")) is not None for cell in header):
        width, header = len(header), _header(comment, delimiter)
        if len(header) != width:
            if not by_position:
                raise NoTable(
                    "has no header: its first row is numbers. Give the columns by position, "
                    "counted from 0: columns=dict(frequency=0, amplitude=1)"
                )
            header = [""] * width
        line, rest = line - 1, f"{first}\n{rest}"
    header = [name or f"column {k}" for k, name in enumerate(header)]
    double = sorted({name for name in header if header.count(name) > 1})
    if double:
        raise NoTable(f"has several columns named {', '.join(double)}")
    body, lines = _rows(rest, line)
    signs = decimal or _decimal_signs(body, delimiter)
    found = _split(body, len(lines), len(header), delimiter, signs)
    if found is None:
        rows = body.split("\n") if lines.size else []
        found = _split_one_by_one(rows, len(header), delimiter, lines)
    table = Table(dict(zip(header, found, strict=True)), {}, lines, "line", "", {})
    return with_signs(with_units_row(table), signs, decimal)


def _first_row(text: str) -> tuple[str, str, int, str]:
    """Return the first row, the last comment before it, its line from 1, and what follows."""
    comment, number, start = "", 0, 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        number += 1
        line = text[start:end]
        plain = line.strip()
        if plain and not plain.startswith("#"):
            return line, comment, number, text[end + 1 :]
        comment = plain.lstrip("#").strip() if plain else comment
        start = end + 1
    raise NoTable("has no rows")


def _rows(text: str, before: int) -> tuple[str, np.ndarray]:
    """Return text without its comments and empty lines, and the line of the file of every row."""
    text = text.rstrip("\n")
    if not any(k in text for k in ("#", "\n\n", "\n ", "\n\t")) and text[:1].strip():
        return text, before + 1 + np.arange(text.count("\n") + 1)
    lines = text.split("\n")
    kept = [k for k, line in enumerate(lines) if line.lstrip()[:1] not in ("", "#")]
    return "\n".join(lines[k] for k in kept), before + 1 + np.array(kept, dtype=int)


def _decimal_signs(body: str, delimiter: str | None) -> str | None:
    """Return what `decimal_signs` does of the cells of some rows."""
    if "," not in body or (delimiter == "," and '"' not in body):
        return None
    parts = body.split('"')
    outside = "".join(parts[::2])
    outside = outside.replace(delimiter, "\n") if delimiter else re.sub(" +", "\n", outside)
    return decimal_signs("\n".join([outside, *parts[1::2]]))


def _split(
    body: str, rows: int, width: int, delimiter: str | None, signs: str | None
) -> list[np.ndarray] | None:
    """Return the columns of many rows, fast: numbers where all cells are; None where rows differ.

    What cells of text say stays as it is.
    """
    import pandas

    # The first row says how many cells there are: from longer ones pandas would make an index.
    if not rows or len(_cells(body.partition("\n")[0], delimiter)) > width:
        return None
    unsettled = signs in ("", ".,")
    try:
        frame = pandas.read_csv(
            io.BytesIO(body.encode()),
            sep=delimiter or r"\s+",
            header=None,
            names=range(width),  # pyright: ignore[reportArgumentType]
            decimal="," if signs == "," else ".",
            dtype=str if unsettled else None,
            keep_default_na=False,
            skip_blank_lines=False,
            skipinitialspace=True,
            low_memory=False,
        )
    except (ValueError, OverflowError):  # such as a row with too many cells
        return None
    if len(frame) != rows:  # a quote goes over several lines
        return None
    columns = [frame[k].to_numpy() for k in range(width)]
    columns = [c if c.dtype.kind in "fiu" else c.astype(object) for c in columns]
    if columns[-1].dtype == object:
        # An empty last cell, or none: then there may be none before it either, empty as well.
        short = np.flatnonzero(columns[-1] == "")
        lines = body.split("\n") if len(short) else []
        for row in short.tolist():
            for k in range(len(_cells(lines[row], delimiter)), width):
                columns[k][row] = None
    return columns


def _split_one_by_one(
    rows: list[str], width: int, delimiter: str | None, lines: np.ndarray
) -> list[np.ndarray]:
    """Return the columns of text of any rows. Raises `NoTable` for one with too many cells."""
    cells = [_cells(row, delimiter) for row in rows]
    wide = [line for line, own in zip(lines, cells, strict=True) if any(own[width:])]
    if wide:
        more = f" and {len(wide) - 1} more lines" if len(wide) > 1 else ""
        hint = ". Put decimal commas in quotes, or semicolons between cells" * (delimiter == ",")
        raise NoTable(f"has more cells than its header's {width} on line {wide[0]}{more}{hint}")
    padded = [own[:width] + [None] * (width - len(own)) for own in cells]
    return [np.array([own[k] for own in padded], dtype=object) for k in range(width)]
