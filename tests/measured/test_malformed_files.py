"""Files that are damaged, or can be read in two ways: a sentence that names what is wrong."""

import contextlib
import datetime

import numpy as np
import pytest
import written_files
from written_files import FRF, RECORD, write_csv, write_uff, write_workbook

from vibrojax.io import read_drive, read_measured_curve, read_measured_history
from vibrojax.measured.mat_files import read_mat

TIME = 1e-3 * np.arange(60)
TIP = np.sin(40 * TIME)
UNITS = dict(displacement="mm")
TEXT = np.array(["oops"] * 60, dtype=object)


def history(path, **how):
    return read_measured_history(path, frequency=6.0, **(dict(units=UNITS) | how))


def curve(path, **how):
    return read_measured_curve(path, **how)


def force(path, **how):
    return read_drive(path, quantity="force", **how)


def run(**changed):
    """A table of a group; None leaves a column out."""
    own = {"time": TIME, "tip": TIP} | changed
    return {"run1": {name: values for name, values in own.items() if values is not None}}


def changed(values, value, place=5):
    found = values.astype(np.result_type(values, value))
    found[place] = value
    return found


LATE = {"t2": TIME[:20], "y2": TIP[:20]}
GROUPS = {
    "nothing at all": ({"run1": {}}, {}, "holds no array"),
    "single values": (run(time=TIME[:1], tip=TIP[:1]), {}, "holds no array"),
    "time alone": (run(tip=None), {}, "no two columns of equal length, .* 60: 'time'"),
    "of other lengths": (run(tip=TIP[:50]), {}, "60: 'time'; 50: 'tip'|50: 'tip'; 60: 'time'"),
    "two tables": (run() | {"run2": run()["run1"]}, {}, "holds 2 tables: 'run1' .*at='run1'"),
    "two lengths": (run(**LATE), {}, "columns of different lengths.*name them, as in columns="),
    "asked for of two lengths": (
        run(**LATE),
        dict(columns=dict(time="t2", displacement="tip")),
        "columns of different lengths",
    ),
    "a shorter column asked for": (
        run(slow=TIP[:20]),
        dict(columns=dict(displacement="slow")),
        "columns of different lengths|no column 'slow'",
    ),
    "no such place": (run(), dict(at="run9"), "nothing at 'run9': there is no .*Known: run1"),
    "a place in an array": (run(), dict(at="run1/tip/x"), "no 'x' in 'run1.tip'"),
    "a place of an array": (run(), dict(at="run1/tip"), "no table at 'run1.tip' but an array of"),
    "a number for a place": (run(), dict(at=3), "holds nothing at 3"),
    "no time": (run(time=None, other=TIME), {}, "No column for the time.*'other'|'tip'"),
    "no signal": (run(tip=None, heat=TIP), {}, "No column for the displacement.*'heat'"),
    "no unit": (run(), dict(units={}), "Column 'tip' says no unit of the displacement"),
    "unknown unit": (run(), dict(units=dict(displacement="furlong")), "must be .*got 'furlong'"),
    "unit of a time": (run(), dict(units=dict(displacement="ms")), "Unit of displacement must be"),
    "unit of nothing": (run(), dict(units=dict(tip="mm")), "units: unknown key 'tip'"),
    "two displacements": (run(disp=TIP), {}, "Columns .* may all be the displacement"),
    "two times": (run(t=TIME), {}, "Columns .* may all be the time"),
    "plain force": (run(force=TIP), {}, "Column 'force' may be the contact force or the force of"),
    "complex": (run(tip=TIP + 1j * TIP), {}, "Column 'tip' is complex .* row 2.*must be real"),
    "text for numbers": (run(tip=TEXT), {}, r"row 1 \(displacement is no number: 'oops'\)"),
    "text for times": (run(time=TEXT), {}, "time is no number: 'oops'"),
    "falling time": (run(time=TIME[::-1].copy()), {}, "time must rise, got 0.059 s then 0.058 s"),
    "a time twice": (run(time=changed(TIME, 0.004)), {}, "time must rise, got 0.004 s then 0.004"),
    "no time in a row": (
        run(time=changed(TIME, np.nan)),
        dict(skip_unusable=False),
        r"1 unusable row: row 6 \(time is nan\)",
    ),
    "infinite": (
        run(tip=changed(TIP, np.inf)),
        dict(skip_unusable=False),
        r"1 unusable row: row 6 \(displacement is inf\)",
    ),
    "no sample": (run(tip=np.full(60, np.nan)), {}, "no usable row: row 1 .no sample."),
    "a channel without samples": (
        run(acceleration_g=np.full(60, np.nan)),
        {},
        "Column 'acceleration_g' holds no acceleration. Leave it out",
    ),
    "three dimensions": (run(time=None, tip=np.ones((3, 4, 5))), {}, "holds no array"),
    "a nameless matrix": (run(time=None, tip=np.ones((60, 2))), {}, "No column for the time.*p 0'"),
    "no such column": (run(), dict(columns=dict(time="clock")), "no column 'clock' for time"),
    "no such position": (run(), dict(columns=dict(time=7)), "time must be a position from 0 to 1"),
    "no such key": (run(), dict(columns=dict(tip="tip")), "columns: unknown key 'tip'"),
    "no such run": (run(), dict(run="Run 1"), "no run='Run 1'. Its columns name no runs"),
    "a window without samples": (run(), dict(window=(5.0, 6.0)), "window must be .*with 0"),
    "a deviation of nothing": (run(), dict(deviation=dict(force=1.0)), "no channel 'force'"),
}  # fmt: skip
RATES = {
    "a rate of zero": (run(time=None, fs=0.0), "says of 'tip' .* steps of inf s"),
    "a negative step": (run(time=None, dt=-1.0), "steps of -1 s: the step must be above 0"),
    "a rate in words": (run(time=None, fs="fast"), "no number in 'fs' but 'fast'"),
    "a rate that is complex": (run(time=None, fs=1j), "no number in 'fs' but"),
}
WRITERS = {
    "mat": ("a.mat", written_files.write_mat),
    "mat 7.3": ("b.mat", written_files.write_mat_73),
    "hdf5": ("a.h5", written_files.write_hdf5),
    "tdms": ("a.tdms", written_files.write_tdms),
}


def refused(read, path, sentence, **how):
    with pytest.raises(ValueError, match=sentence) as refusal:
        read(path, **how)
    sentence = str(refusal.value)
    assert sentence.startswith(("Measured ", "Drive "))
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert len(sentence) < 1500


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("case", GROUPS)
def test_groups_that_are_no_table_or_several(tmp_path, kind, case):
    name, write = WRITERS[kind]
    tree, how, sentence = GROUPS[case]
    if kind == "tdms" and case == "three dimensions":
        pytest.skip("its channels have one dimension")
    if kind == "tdms" and case == "a nameless matrix":
        pytest.skip("its channels have one dimension")
    refused(history, write(tmp_path / name, tree), sentence, **how)


@pytest.mark.parametrize("kind", ["mat", "mat 7.3", "hdf5"])
@pytest.mark.parametrize("case", RATES)
def test_rates_that_are_none(tmp_path, kind, case):
    name, write = WRITERS[kind]
    tree, sentence = RATES[case]
    refused(history, write(tmp_path / name, tree), sentence)


CLOCK = dict(wf_increment=1e-3, wf_start_offset=0.0)
CLOCKS = {
    "a step of zero": (CLOCK | dict(wf_increment=0.0), "steps of 0 s: the step must be above 0"),
    "no step": (CLOCK | dict(wf_increment=float("nan")), "steps of nan s"),
    "no start": (CLOCK | dict(wf_start_offset=float("inf")), "starts at inf s"),
    "steps of frequency": (CLOCK | dict(wf_xunit_string="Hz"), "no two columns of equal length"),
    "unknown steps": (CLOCK | dict(wf_xunit_string="furlong"), "no two columns of equal length"),
}


@pytest.mark.parametrize("case", CLOCKS)
def test_clocks_of_tdms_that_are_none(tmp_path, case):
    properties, sentence = CLOCKS[case]
    path = written_files.write_tdms(tmp_path / "a.tdms", {"run": {"tip": (TIP, "mm", properties)}})
    refused(history, path, sentence)


GOOD = [["t_s", "tip_mm"], *([0.1 * k, 1.5 + 0.25 * k] for k in range(9))]


def rows(header):
    """The good table with another header."""
    return [header, *GOOD[1:]]


def cell(value, column=1):
    """The good table with another cell in its third row."""
    return [*GOOD[:2], [value if k == column else one for k, one in enumerate(GOOD[2])], *GOOD[3:]]


WIDE = ["Run 1: t_s", "Run 1: tip_mm", "Run 2: t_s", "Run 2: tip_mm"]
STRICT = dict(skip_unusable=False)
TABLES = {
    "header alone": (history, GOOD[:1], {}, "no table of two columns|no usable row|is no table"),
    "one column": (history, [row[:1] for row in GOOD], {}, "No column for the d|no table"),
    "no header": (history, GOOD[1:], {}, "has no header: .*columns=dict"),
    "a name twice": (history, rows(["t_s", "t_s"]), {}, "has several columns named t_s"),
    "no time": (history, rows(["a", "tip_mm"]), {}, "No column for the time.*'a', 'tip_mm'"),
    "no signal": (history, rows(["t_s", "b"]), {}, "No column for the displacement.*'t_s', 'b'"),
    "no unit": (history, rows(["t_s", "tip"]), dict(units={}), "'tip' says no unit of the displ"),
    "unknown unit": (history, rows(["t_s", "tip [ell]"]), dict(units={}), "Unit of .*got 'ell'"),
    "unit of a force": (history, rows(["t_s", "tip [N]"]), dict(units={}), "Unit of .*got 'N'"),
    "unit of time": (history, rows(["t [h]", "tip_mm"]), {}, "Unit of time must .*got 'h'"),
    "two displacements": (
        history, [["t_s", "tip_mm", "y_mm"], *([*r, 1] for r in GOOD[1:])], {}, "all be the disp",
    ),
    "plain force": (history, rows(["t_s", "force_N"]), {}, "'force_N' may be the contact force"),
    "text": (history, cell("oops"), STRICT, r"1 unusable row: .* 3 \(displacement is .*'oops'"),
    "an error of a formula": (history, cell("#DIV/0!"), STRICT, r"3 \((no sample|.*'#DIV/0!')\)"),
    "no cell": (history, cell(None), STRICT, r"1 unusable row: .* 3 \(no sample\)"),
    "no time in a row": (history, cell(None, 0), STRICT, r"1 unusable row: .* 3 \(time is n"),
    "infinite": (history, cell("inf"), STRICT, r"3 \(displacement is inf\)"),
    "complex": (history, cell("1+2j"), {}, r"'tip_mm' is complex \(1\+2j on .* 3\)"),
    "falling time": (history, cell(5.0, 0), {}, "time must rise, got 5 s then 0.2 s at index 2"),
    "a time twice": (history, cell(0.0, 0), {}, "time must rise, got 0 s then 0 s at index 1"),
    "thousands or decimals": (
        history, [GOOD[0], *([k, f"{k},250"] for k in range(1, 9))], {}, "holds '1,250', which is",
    ),
    "no such run": (history, GOOD, dict(run="Run 3"), "no run='Run 3'. Its columns name no runs"),
    "no such run of several": (
        history, [WIDE, *(row * 2 for row in GOOD[1:])], dict(run="Run 3"), "Known: Run 1, Run 2",
    ),
    "a column twice in a run": (
        history, [["t_s", "Run 1: t_s", "Run 1: tip_mm"], *([r[0], *r] for r in GOOD[1:])], {},
        "several columns t_s in Run 1",
    ),
    "a run without samples": (
        history, [WIDE, *([*row, None, None] for row in GOOD[1:])], {}, "Run 2': There is no us",
    ),
    "several runs of a drive": (
        force, [[h.replace("tip_mm", "force_N") for h in WIDE], *(row * 2 for row in GOOD[1:])], {},
        "There are several runs: 'Run 1', 'Run 2'. Say which: run='Run 1'",
    ),
    "no such column": (history, GOOD, dict(columns=dict(time="clock")), "no column 'clock' for"),
    "no such position": (history, GOOD, dict(columns=dict(time=9)), "a position from 0 to 1"),
    "a name that is a number": (history, GOOD, dict(columns=dict(tip=1)), "key 'tip'"),
    "a history as a curve": (curve, GOOD, {}, "No column for the frequency.*'t_s'"),
    "negative amplitudes": (
        curve, [["f_Hz", "tip_mm"], *([k, -1.0] for k in range(1, 9))], {}, "looks like a signal",
    ),
    "an unknown direction": (
        curve, [["f_Hz", "tip_mm", "dir"], [1, 1, "up"], [2, 2, "left"]], STRICT,
        "direction is not .*'left'",
    ),
    "two amplitudes": (
        curve, [["f_Hz", "tip_mm", "acc_g"], [1, 1, 1], [2, 2, 2]], {}, "may all be the amplitude",
    ),
    "half a response": (curve, [["f_Hz", "Re(H)"], [1, 1], [2, 2]], {}, "no other part"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "write"), [("a.csv", write_csv), ("a.xlsx", write_workbook)])
@pytest.mark.parametrize("case", TABLES)
def test_tables_that_are_none_or_not_clear(tmp_path, name, write, case):
    read, table, how, sentence = TABLES[case]
    how = {"units": {}} | how if read is history else how
    refused(read, write(tmp_path / name, table), sentence, **how)


def test_sheets_that_are_not_clear(tmp_path):
    day = datetime.datetime(2024, 5, 1)
    clock = datetime.time(1, 2, 3)
    for table, sheets, how, sentence in (
        (GOOD, {"run2": GOOD}, {}, "has 2 sheets: 'run1', 'run2'. Say which: at='run1'"),
        (GOOD, {}, dict(at="run7"), "has no sheet at='run7'. Its sheets are 'run1'"),
        (GOOD, {"empty": []}, dict(at="empty"), "no table of two columns in 'empty'"),
        ([["only a title"]], {}, {}, "no table of two columns in 'run1'"),
        (cell(day, 0), {}, {}, "Column 't_s' for the time holds dates or durations"),
        (cell(clock, 0), {}, {}, "Column 't_s' for the time holds dates or durations"),
    ):
        path = write_workbook(tmp_path / "a.xlsx", table, sheets)
        refused(history, path, sentence, units={}, **how)


def frf(unit="mm", below="N", **fields):
    """A frequency response."""
    own = dict(x=np.linspace(5, 15, 40), data=np.linspace(1, 2, 40) + 0.5j)
    units = dict(ordinate_axis_units_lab=unit, orddenom_axis_units_lab=below)
    return FRF | units | own | fields


def wave(unit="mm", kind=8, **fields):
    """A time response of a kind of quantity, by its number."""
    units = dict(ordinate_axis_units_lab=unit, ordinate_spec_data_type=kind)
    return RECORD | units | dict(x=TIME, data=TIP) | fields


SYSTEM = dict(type=164, units_code=1, length=1.0, force=1.0, temp=1.0, temp_offset=0.0)
BARE = dict(units={})
UNIVERSAL = {
    "no function": (curve, [SYSTEM], {}, "no function .data set 58., but data sets 164"),
    "two responses": (curve, [frf(), frf()], {}, "holds 2 functions of frequency.*at=1"),
    "no such record": (curve, [frf()], dict(at=2), "no record at=2. Its records are 1: frequ"),
    "a path for a record": (curve, [frf()], dict(at="a/b"), "no record at='a/b'"),
    "a history as a curve": (curve, [wave()], {}, "no function of frequency .*1: time resp"),
    "a record of time": (curve, [wave(), frf()], dict(at=1), "record 1 a time response .*freq"),
    "a curve as a history": (history, [frf()], {}, "no function of time .*1: frequency resp"),
    "an auto spectrum": (curve, [frf(func_type=2)], {}, "1: auto spectrum"),
    "a power density": (curve, [frf(func_type=9)], {}, "1: power spectral density"),
    "a coherence": (curve, [frf(func_type=6)], {}, "1: coherence"),
    "an orbit": (curve, [frf(func_type=17)], {}, "1: function of type 17"),
    "over revolutions": (curve, [frf(abscissa_spec_data_type=19)], {}, "no function of frequ"),
    "over anything": (curve, [frf(func_type=0, abscissa_spec_data_type=1)], {}, "1: general"),
    "in miles": (curve, [frf(abscissa_axis_units_lab="mi")], {}, "frequencies in 'mi'"),
    "an unknown unit": (curve, [frf("ell")], {}, "'ell' over 'N'"),
    "an unknown unit below": (curve, [frf("mm", "lbf")], {}, "'mm' over 'lbf'"),
    "nothing below": (curve, [frf("mm", "NONE")], {}, "'' over 'mm'"),
    "a force over a motion": (curve, [frf("N", "mm")], {}, "units of a motion over a force"),
    "over a voltage": (curve, [frf("mm", "V")], {}, "a response over 'V'"),
    "acceleration without a unit": (
        curve, [frf("NONE", "NONE", ordinate_spec_data_type=12)], {},
        "acceleration over excitation force.*units of a motion",
    ),
    "no unit": (curve, [frf("NONE", "NONE")], {}, "says no unit of the amplitude"),
    "a history without unit": (history, [wave("NONE")], BARE, "'displacement' says no unit"),
    "a history in ells": (history, [wave("ell")], BARE, "got 'ell'"),
    "times in ells": (
        history, [wave(abscissa_axis_units_lab="ell")], {}, "Unit of time must .*got 'ell'",
    ),
    "two clocks": (
        history, [wave(), wave("N", 13, abscissa_axis_units_lab="ms")], {}, "times in 's', 'ms'",
    ),
    "a record twice": (history, [wave(), wave()], {}, r"several records of displacement 3\+Z"),
    "two places": (history, [wave(), wave(rsp_node=4)], {}, r"'displacement 4\+Z'"),
    "an unknown quantity": (history, [wave(kind=0)], {}, "'record 1'"),
    "a reaction": (history, [wave("N", 9)], {}, "'force' may be the contact force"),
    "falling time": (history, [wave(x=TIME[::-1].copy())], {}, "of 'displacement' .*not rise"),
    "complex over time": (history, [wave(data=TIP + 1j)], {}, "'displacement' is complex"),
    "two forces": (force, [wave("N", 13), wave("N", 9)], {}, "may all be the force"),
    "a motion for a force": (force, [wave()], {}, "No column for the force"),
}  # fmt: skip


@pytest.mark.parametrize("case", UNIVERSAL)
def test_universal_files_that_are_not_clear(tmp_path, case):
    read, records, how, sentence = UNIVERSAL[case]
    refused(read, write_uff(tmp_path / "a.uff", records), sentence, **how)


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda raw: raw[: len(raw) // 2], "cut short: its last data set has no end"),
        (lambda raw: raw.replace(b"        40", b"        41"), "says 41 values of record 1, and"),
        (lambda raw: raw.replace(b"        40", b"        39"), "says 39 values of record 1, and"),
        (lambda raw: raw.replace(b"        40", b"        xx"), "record 1 header that cannot"),
        (lambda raw: raw.replace(b"5.00000e+00", b"5.0000oe+00"), "record 1 values that cannot"),
        (lambda raw: b"no universal file", "no function .data set 58., but data sets none"),
        (lambda raw: b"", "no function .data set 58., but data sets none"),
    ],
)
def test_damaged_universal_files(tmp_path, damage, sentence):
    path = write_uff(tmp_path / "a.uff", [frf()])
    path.write_bytes(damage(path.read_bytes()))
    refused(curve, path, sentence)


def written(folder):
    """Files of all formats with what reads them."""
    for kind, (name, write) in WRITERS.items():
        yield kind, write(folder / name, run()), history
    yield "csv", write_csv(folder / "a.csv", GOOD), history
    yield "workbook", write_workbook(folder / "a.xlsx", GOOD), history
    yield "uff", write_uff(folder / "a.uff", [frf()]), curve
    yield "uff 58b", write_uff(folder / "b.uff", [wave(binary=1)]), history


@pytest.mark.parametrize("kind", [*WRITERS, "csv", "workbook", "uff", "uff 58b"])
def test_bytes_cut_off_or_changed_at_random(tmp_path, kind):
    path, read = next((p, r) for k, p, r in written(tmp_path) if k == kind)
    raw, rng = path.read_bytes(), np.random.default_rng(0)
    refusals = 0
    for part in [*np.linspace(0.0, 0.98, 15), *[None] * 25]:
        damaged = np.frombuffer(raw, np.uint8).copy()
        if part is None:
            places = rng.integers(0, len(raw), 8)
            damaged[places] = rng.integers(0, 256, 8)
        else:
            damaged = damaged[: int(part * len(raw))]
        path.write_bytes(damaged.tobytes())
        refusal = outcome(read, path)
        refusals += refusal is not None
        assert refusal is None or (refusal.startswith("Measured ") and "\n" not in refusal)
    assert refusals >= 10


def test_a_damaged_mat_file_does_not_crash_scipy(tmp_path):
    tree = {"run1": {"tip": (TIP[:3] + 1j, "mm"), "text": "wet"}, "cell": np.array([1, "a"], "O")}
    raw = written_files.write_mat(tmp_path / "a.mat", tree).read_bytes()
    for place in range(124, len(raw)):
        for value in (5, 8, 200):
            with contextlib.suppress(Exception):
                read_mat(raw[:place] + bytes([value]) + raw[place + 1 :])


def outcome(read, path):
    """Return the sentence by which a file is refused; None where it is read."""
    try:
        read(path)
    except ValueError as error:
        return str(error)
    return None


@pytest.mark.parametrize("kind", [*WRITERS, "workbook", "uff"])
def test_a_file_of_another_kind_under_the_name(tmp_path, kind):
    path, read = next((p, r) for k, p, r in written(tmp_path) if k == kind)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    refused(read, path, "cannot be read as|is not text|no function")
