"""Files as instruments and spreadsheets write them, and damaged ones."""

import os
from itertools import product

import numpy as np
import pandas
import pytest
import xarray

import vibrojax as vj
from vibrojax.measured import text_files
from vibrojax.measured.cells import number_in, numbers_in

TABLE = "f [Hz]\ttip [µm]\n10.5\t5.4\n11.5\t6.4\n"
UNITS = dict(frequency="Hz", amplitude="mm")


def write(folder, content, name="sweep.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1"]
)
def test_encodings(tmp_path, encoding):
    curve = vj.io.read_measured_curve(write(tmp_path, TABLE.encode(encoding)))
    np.testing.assert_allclose(curve.amplitude, [5.4e-6, 6.4e-6])
    np.testing.assert_array_equal(curve.lines, [2, 3])


def test_line_ends_and_the_end_of_dos_files(tmp_path):
    for ended in (TABLE.replace("\n", "\r\n"), TABLE.replace("\n", "\r"), TABLE + "\x1a"):
        assert vj.io.read_measured_curve(write(tmp_path, ended)).size == 2


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("9;5,400\n10;5,43\n", [5.4, 5.43]),
        ("9;0,250\n10;5,400\n", [0.25, 5.4]),
        ("9,5;5,400\n10;1,234\n", [5.4, 1.234]),
        ("9;5,400e0\n10;1,234e0\n", [5.4, 1.234]),
        ("9;1.234,5\n10;1.234\n", [1234.5, 1234.0]),
        ("9;1.234.567\n10;5,400\n", [1234567.0, 5.4]),
        ("9;5,400.5\n10;1,234\n", [5400.5, 1234.0]),
        ("9;999.5\n10;5,400\n", [999.5, 5400.0]),
        ("9;1,234,567\n10;5,400\n", [1234567.0, 5400.0]),
        ("9.5;1,5\n10.5;2,5\n", [1.5, 2.5]),
        ("9.5;1,5\n10.5;2.5\n", [1.5, 2.5]),
    ],
)
@pytest.mark.parametrize("delimiter", [";", "\t", "  ", '","'])
def test_the_file_shows_its_decimal_sign(tmp_path, rows, expected, delimiter):
    text = f"f_Hz;tip_mm\n{rows}"
    if delimiter == '","':
        text = "\n".join(f'"{line}"' if line else "" for line in text.split("\n"))
    path = write(tmp_path, text.replace(";", delimiter))
    curve = vj.io.read_measured_curve(path)
    np.testing.assert_allclose(curve.amplitude * 1e3, expected, rtol=1e-14)
    assert any("Commas" in note for note in curve.notes)


@pytest.mark.parametrize("rows", ["9;5,400\n10;6,100\n", "9.5;5,400\n10.5;6,100\n"])
@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_a_doubtful_decimal_sign_is_asked_about(tmp_path, rows, delimiter):
    path = write(tmp_path, f"f_Hz;tip_mm\n{rows}".replace(";", delimiter))
    sentence = r"Column 'tip_mm' holds '5,400', which is 5400 .* and 5.4 .*decimal='.' or decimal="
    with pytest.raises(ValueError, match=sentence):
        vj.io.read_measured_curve(path)
    point = vj.io.read_measured_curve(path, decimal=".")
    np.testing.assert_allclose(point.amplitude, [5.4, 6.1])
    if "." not in rows:
        comma = vj.io.read_measured_curve(path, decimal=",")
        np.testing.assert_allclose(comma.amplitude, [5.4e-3, 6.1e-3])
    with pytest.raises(ValueError, match=r"decimal must be one of '\.', ','"):
        vj.io.read_measured_curve(path, decimal=";")
    history = write(tmp_path, f"t_s;tip_mm\n{rows}".replace(";", delimiter))
    with pytest.raises(ValueError, match=r"Measured history .* decimal='\.' or decimal=','"):
        vj.io.read_measured_history(history, frequency=1.0)


def test_a_column_that_is_not_used_is_not_asked_about(tmp_path):
    path = write(tmp_path, "f_Hz;tip_mm;counts\n9;1;5,400\n10;2;6,100\n")
    assert vj.io.read_measured_curve(path).size == 2


def test_text_of_data_frames_has_decimal_commas_too():
    frame = pandas.DataFrame({"f_Hz": ["9,5", "10"], "tip_mm": ["0,5", "1,25"]})
    np.testing.assert_allclose(vj.io.read_measured_curve(frame).amplitude, [5e-4, 1.25e-3])
    with pytest.raises(ValueError, match="holds '5,400'"):
        vj.io.read_measured_curve({"f_Hz": [9, 10], "tip_mm": ["5,400", "6,100"]})


NUMBERS = (
    "1 -2.5 +.5 1. 1e-3 2E5 4.9e-324 1e400 -inf nan 123456789012345678901 0.1234567890123456789"
)
ODD_CELLS = (
    "",
    " ",
    "oops",
    "1,5",
    '"1,5"',
    '5" pipe',
    "1e",
    "0x10",
    "1_0",
    "--1",
    "1 2",
    "True",
    "NA",
    "1+2j",
    "2024-01-01",
)


@pytest.mark.parametrize("delimiter", [";", "\t", ",", None])
@pytest.mark.parametrize("odd", ODD_CELLS)
def test_the_fast_way_reads_as_the_slow_one(delimiter, odd):
    between = delimiter or "  "
    rows = [between.join((n, "up", "7")) for n in NUMBERS.split()]
    rows[3:3] = [between.join((odd, "down", "8")), between.join(("1", "up"))]
    width = 3
    lines = np.arange(len(rows))
    fast = text_files._split("\n".join(rows), len(rows), width, delimiter, None)
    try:
        slow = text_files._split_one_by_one(rows, width, delimiter, lines)
    except ValueError:  # more cells than the header
        assert fast is None
        return
    if fast is None:
        return
    for quick, careful in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(numbers_in(quick), numbers_in(careful))
        for one, other in zip(quick, careful, strict=True):
            if number_in(one) is None:
                assert (one is None) == (other is None)
                assert str(one).strip() in (str(other).strip(), "True")


def test_long_tables_take_the_fast_way(monkeypatch, tmp_path):
    monkeypatch.setattr(text_files, "_split_one_by_one", None)
    text = "".join(f"{k},{k / 7:.9g},{'up' if k < 500 else 'down'}\n" for k in range(1, 1000))
    curve = vj.io.read_measured_curve(write(tmp_path, f"# made\nf_Hz,tip_mm,dir\n\n{text}"))
    np.testing.assert_array_equal(curve.lines, np.arange(4, 1003))
    assert curve.amplitude[69] == pytest.approx(10e-3)
    assert curve.forward.sum() == 499


def test_a_series_and_a_data_array():
    index = pandas.Index([9.0, 10.0], name="frequency [Hz]")
    series = pandas.Series([1.0, 2.0], index=index, name="tip [mm]")
    np.testing.assert_allclose(vj.io.read_measured_curve(series).amplitude, [1e-3, 2e-3])
    np.testing.assert_allclose(vj.io.read_measured_curve(series.to_frame()).frequency, [9.0, 10.0])
    for unnamed in (series.rename(None), series.rename_axis(None), pandas.Series([1.0, 2.0])):
        with pytest.raises(ValueError, match=r"The series does not say .*rename_axis\('freq"):
            vj.io.read_measured_curve(unnamed)
    array = xarray.DataArray([1.0, 2.0], {"f": [9.0, 10.0]}, name="tip")
    np.testing.assert_allclose(
        vj.io.read_measured_curve(array, units=UNITS).amplitude, [1e-3, 2e-3]
    )
    with pytest.raises(ValueError, match="data array has no name"):
        vj.io.read_measured_curve(array.rename(None))


def test_masked_values_dates_and_booleans_are_no_numbers():
    masked = np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])
    curve = vj.io.read_measured_curve({"f_Hz": [9, 10, 11], "tip_mm": masked})
    np.testing.assert_allclose(curve.frequency, [9.0, 11.0])
    dates = pandas.date_range("2026-01-01", periods=3)
    with pytest.raises(ValueError, match="'t_s' for the time holds dates or durations"):
        vj.io.read_measured_history({"t_s": dates, "tip_mm": [1, 2, 3]}, frequency=1.0)
    with pytest.raises(ValueError, match="no usable row"):
        vj.io.read_measured_curve({"f_Hz": [9, 10], "tip_mm": [True, True]})


def test_durations_of_netcdf_files_stay_numbers(tmp_path):
    dataset = xarray.Dataset(
        {"tip": ("time", [1.0, 2.0, 1.0], {"units": "mm"})},
        {"time": ("time", [0.0, 0.1, 0.2], {"units": "seconds"})},
    )
    dataset.to_netcdf(tmp_path / "tip.nc", engine="h5netcdf")
    history = vj.io.read_measured_history(tmp_path / "tip.nc", frequency=1.0)
    np.testing.assert_allclose(history.time, [0.0, 0.1, 0.2])


@pytest.mark.parametrize("read", ["curve", "history", "rig"])
def test_what_is_no_file_is_said(tmp_path, read):
    readers = {
        "curve": vj.io.read_measured_curve,
        "history": lambda path: vj.io.read_measured_history(path, frequency=1.0),
        "rig": vj.io.read_rig,
    }
    os.mkfifo(tmp_path / "pipe")
    for path, sentence in (
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "is a pipe or a device"),
        (tmp_path / "none", "does not exist"),
        (write(tmp_path, "") / "none", "cannot be read: Not a directory"),
        ("x" * 5000, "cannot be read: File name too long"),
        ("x\0y", "must be the path of a file"),
        ("", "must be the path of a file"),
    ):
        with pytest.raises(ValueError, match=sentence):
            readers[read](path)


def test_what_is_no_text_is_said(tmp_path):
    for start, sentence in (
        (b"PK\x03\x04", "cannot be read as a workbook"),
        (b"\x1f\x8b", "compressed: unpack it"),
        (b"\x89PNG\r\n\x1a\n", "is not text"),
        (b"\xff\xfe1", "begins as UTF-16 but is not"),
        (b"\x89HDF\r\n\x1a\n", "cannot be read as HDF5"),
    ):
        with pytest.raises(ValueError, match=f"Measured curve from .*{sentence}"):
            vj.io.read_measured_curve(write(tmp_path, start + bytes(range(256))[: 256 // 2 * 2]))


GOOD = [("f [Hz]", "tip [mm]", "dir")] + [
    (f"{8 + k / 4}", f"{1 + (k % 5) / 8}", "up") for k in range(12)
]
DAMAGES = {
    "none": lambda text, d: text,
    "truncated": lambda text, d: text[:-9],
    "cut header": lambda text, d: text[5:],
    "no header": lambda text, d: text.split("\n", 1)[1],
    "header only": lambda text, d: text.split("\n")[0],
    "header twice": lambda text, d: text.split("\n")[0] + "\n" + text,
    "one row": lambda text, d: "\n".join(text.split("\n")[:2]),
    "comments": lambda text, d: text.replace("\n", "\n# pause\n"),
    "empty lines": lambda text, d: text.replace("\n", "\n\n \n\t\n"),
    "short row": lambda text, d: text + "9\n",
    "long row": lambda text, d: text + d.join("123456") + "\n",
    "trailing delimiters": lambda text, d: text.replace("\n", f"{d}\n"),
    "mixed delimiters": lambda text, d: text.replace(d, ",", 9),
    "open quote": lambda text, d: text.replace("9", '"9'),
    "quotes": lambda text, d: text.replace("8", '"8"'),
    "quoted line end": lambda text, d: text.replace("up", '"u\np"'),
    "decimal commas": lambda text, d: text.replace(".", ","),
    "some decimal commas": lambda text, d: text.replace(".", ",", 3),
    "thousands": lambda text, d: text.replace("8.0", "8,000"),
    "text for numbers": lambda text, d: text.replace("8", "eight"),
    "complex": lambda text, d: text.replace("1.25", "1+2j"),
    "huge": lambda text, d: text.replace("1.25", "1e999"),
    "negative": lambda text, d: text.replace("1.", "-1."),
    "zeros": lambda text, d: text.replace("1.", "0."),
    "words for directions": lambda text, d: text.replace("up", "sideways"),
    "units in the second row": lambda text, d: text.replace("\n", f"\nHz{d}mm{d}-\n", 1),
    "double column": lambda text, d: text.replace("tip [mm]", "f [Hz]"),
    "unknown unit": lambda text, d: text.replace("[mm]", "[furlong]"),
    "force": lambda text, d: text.replace("tip [mm]", "force [N]"),
    "bom": lambda text, d: "\ufeff\ufeff" + text,
    "null": lambda text, d: text.replace("8", "\0", 1),
    "control": lambda text, d: text.replace("8", "\x07"),
    "line separators": lambda text, d: text.replace("\n", "\u2028", 4),
    "long cell": lambda text, d: text.replace("up", "u" * 200_000, 1),
    "nothing": lambda text, d: "",
}


def outcome(path):
    try:
        return vj.io.read_measured_curve(path), ""
    except ValueError as error:
        return None, str(error)


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("delimiter", [";", "\t", ",", "  "])
def test_damaged_files_are_read_or_refused_by_a_sentence(tmp_path, damage, delimiter):
    text = "".join(delimiter.join(row) + "\n" for row in GOOD)
    damaged = DAMAGES[damage](text, delimiter)
    for encoding, end in product(("utf-8", "utf-16", "latin-1"), ("\n", "\r\n")):
        raw = damaged.replace("\n", end).encode(encoding, "replace")
        curve, sentence = outcome(write(tmp_path, raw))
        if curve is None:
            assert sentence.startswith("Measured curve from ")
            assert sentence.endswith(".")
            assert "\n" not in sentence
            assert len(sentence) < 2000
            continue
        assert np.isfinite(curve.frequency).all()
        assert set(curve.frequency) <= {8 + k / 4 for k in range(12)} | {9.0, 8.0, 80.0, 8e3}
        assert len(repr(curve)) < 3000
