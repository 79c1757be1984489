"""Measurements in the formats of laboratories, written by other libraries and read back."""

import sys

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
import written_files
from numpy.testing import assert_allclose, assert_array_equal
from written_files import FRF, RECORD, write_csv, write_uff, write_workbook

import vibrojax as vj
from vibrojax.io import read_drive, read_measured_curve, read_measured_history
from vibrojax.measured.tables import read_table

TIME = 1e-3 * np.arange(200)
TIP = np.sin(40 * TIME)
FREQUENCY = np.linspace(5.0, 15.0, 41)
RESPONSE = 1 / (4e3 - (2 * np.pi * FREQUENCY) ** 2 + 20j * FREQUENCY)
WRITERS = {
    "mat": ("a.mat", written_files.write_mat),
    "mat 7.3": ("b.mat", written_files.write_mat_73),
    "hdf5": ("a.h5", written_files.write_hdf5),
    "tdms": ("a.tdms", written_files.write_tdms),
}


def history(path, **how):
    return read_measured_history(path, frequency=6.0, **how)


def said(notes, words):
    return any(words in note for note in notes)


@pytest.mark.parametrize("kind", WRITERS)
def test_groups_of_arrays(tmp_path, kind):
    name, write = WRITERS[kind]
    run = {"time": (TIME, "s"), "tip": (TIP, "mm"), "force": (2 * TIP, "N"), "other": TIP[:50]}
    path = write(tmp_path / name, {"run1": run, "run2": run | {"tip": (3 * TIP, "um")}})
    with pytest.raises(ValueError, match=r"holds 2 tables: 'run1' .*; 'run2' .*at='run1'\."):
        history(path)
    columns = dict(contact_force="force")
    read = history(path, at="run2", columns=columns)
    assert_allclose(read.time, TIME)
    assert_allclose(read.displacement, 3e-6 * TIP)
    assert_allclose(read.contact_force, 2 * TIP)
    assert said(read.notes, "'tip' as displacement in um")
    assert said(read.notes, "Read from 'run2'")
    assert said(read.notes, "Left out, as their length is not 200: 'other'.")
    shaking = read_drive(path, at="run1", quantity="force")
    assert_allclose(shaking.values, 2 * TIP)


@pytest.mark.parametrize("kind", WRITERS)
def test_complex_responses_in_groups(tmp_path, kind):
    name, write = WRITERS[kind]
    sweep = {"frequency_Hz": FREQUENCY, "amplitude": (RESPONSE, "m/N")}
    curve = read_measured_curve(write(tmp_path / name, {"up": sweep}), direction="up")
    assert_allclose(curve.amplitude, abs(RESPONSE))
    assert_allclose(curve.phase, np.angle(RESPONSE))
    assert curve.forward.all()


@pytest.mark.parametrize("kind", ["mat", "mat 7.3", "hdf5"])
def test_deep_groups_matrices_rates_and_scattered_arrays(tmp_path, kind):
    name, write = WRITERS[kind]
    path = tmp_path / name
    deep = {"bench": {"day 1": {"run.2": {"t": TIME, "tip_mm": TIP}}, "note": "wet"}}
    if "mat" not in name:  # where names may be anything
        assert_allclose(history(write(path, deep)).displacement, 1e-3 * TIP)
        assert_allclose(history(path, at="/bench/day 1/run.2").displacement, 1e-3 * TIP)
    matrix = write(path, {"data": np.stack([TIME, TIP, 2 * TIP], axis=1), "note": "x"})
    with pytest.raises(ValueError, match=r"No column for the time.*'data 0', 'data 1', 'data 2'"):
        history(matrix)
    how = dict(columns=dict(time=0, displacement="data 2"), units=dict(displacement="mm"))
    assert_allclose(history(matrix, **how).displacement, 2e-3 * TIP)
    assert_allclose(history(matrix, at="data", **how).displacement, 2e-3 * TIP)
    sampled = history(write(path, {"fs": 1000.0, "tip": (TIP, "m")}))
    assert_allclose(sampled.time, TIME)
    assert said(sampled.notes, "The time was made of steps of 0.001 s that the file says.")
    kilohertz = history(write(path, {"fs_kHz": 1.0, "tip": (TIP, "m")}))
    assert_allclose(kilohertz.time, TIME)
    scattered = history(write(path, {"t": TIME, "signals": {"tip_mm": TIP, "gain": 3.0}}))
    assert_allclose(scattered.displacement, 1e-3 * TIP)


def test_objects_of_matlab_are_named(tmp_path):
    path = written_files.write_mat_73(tmp_path / "a.mat", {"table": np.arange(6), "other": TIME})
    with h5py.File(path, "r+") as file:
        file["table"].attrs["MATLAB_object_decode"] = 3
        del file["other"]
    with pytest.raises(ValueError, match="holds no array but 'table', empty or of a kind that"):
        history(path)


def test_arrays_of_structs_and_cells(tmp_path):
    runs = [{"t": TIME, "tip_mm": k * TIP} for k in (1, 2)]
    both = np.array(runs, dtype=object)
    five = written_files.write_mat(tmp_path / "five.mat", {"run": {"s": both}})
    later = written_files.write_mat_73(tmp_path / "later.mat", {"run": runs})
    for path, at in ((five, "run.s(2)"), (later, "run(2)")):
        assert_allclose(history(path, at=at).displacement, 2e-3 * TIP)
    sweep = {"f_Hz": FREQUENCY[:3], "tip_mm": TIP[1:4], "sweep": np.array(["up"] * 3, dtype=object)}
    for write in (written_files.write_mat, written_files.write_mat_73, written_files.write_hdf5):
        name = "sweep.h5" if write is written_files.write_hdf5 else "sweep.mat"
        assert read_measured_curve(write(tmp_path / name, sweep)).forward.all()


def test_hdf5_datasets_of_records_named_columns_and_links(tmp_path):
    path = tmp_path / "a.h5"
    records = np.zeros(200, [("t", float), ("tip", float)])
    records["t"], records["tip"] = TIME, TIP
    with h5py.File(path, "w") as file:
        file["run"] = records
        file["run"].attrs["units"] = ["s", "mm"]
        file["loop"] = h5py.SoftLink("/")
        file["gone"] = h5py.ExternalLink("gone.h5", "/x")
        file["nothing"] = h5py.Empty("f")
    assert_allclose(history(path).displacement, 1e-3 * TIP)
    with h5py.File(path, "w") as file:
        file["m"] = np.stack([TIME, TIP])
        file["m"].attrs["columns"] = ["time [s]", "tip [mm]"]
    assert_allclose(history(path).displacement, 1e-3 * TIP)


def test_channels_of_tdms_on_clocks_of_their_own(tmp_path):
    clock = dict(wf_increment=1e-3, wf_start_offset=0.0)
    clock["wf_start_time"] = np.datetime64("2024-05-01T10:00:00.000000")
    late = clock | dict(wf_start_time=np.datetime64("2024-05-01T10:00:00.004000"))
    run = {"tip": (TIP, "mm", clock), "acc": (TIP[:49], "g", late | dict(wf_increment=4e-3))}
    path = written_files.write_tdms(tmp_path / "a.tdms", {"run": run})
    read = history(path)
    assert_allclose(read.time, TIME, atol=1e-12)
    assert_allclose(read.displacement, 1e-3 * TIP)
    sampled = np.flatnonzero(np.isfinite(read.acceleration))
    assert_array_equal(sampled, 4 + 4 * np.arange(49))
    assert said(read.notes, "clocks of their own ('tip' 200, 'acc' 49 samples of 200)")
    assert history(path, columns=dict(acceleration=None)).size == 200


ROWS = [["Run 1: Time (s)", "Run 1: Force (N)", "Run 1: Position (m)"]]
ROWS[0] += ["Latest: Time (s)", "Latest: Force (N)", "Latest: Position (m)"]
ROWS += [
    [0.1 * k, -0.5 * k, 0.01 * k if k % 4 == 0 else None]
    + ([0.1 * k, -0.25 * k, None if k % 4 else 0.02 * k] if k < 20 else [None] * 3)
    for k in range(40)
]


@pytest.mark.parametrize(("name", "write"), [("a.csv", write_csv), ("a.xlsx", write_workbook)])
def test_runs_side_by_side(tmp_path, name, write):
    path = write(tmp_path / name, ROWS)
    columns = dict(contact_force="Force (N)", displacement=None)
    first, latest = history(path, columns=columns)
    assert (first.label, first.size) == ("a, Run 1", 40)
    assert (latest.label, latest.size) == ("a, Latest", 20)
    assert_allclose(latest.contact_force, -0.25 * np.arange(20))
    assert history(path, columns=columns, run="latest").label == "a, Latest"
    with pytest.raises(ValueError, match=r"There is no run='Run 2'\. .*Known: Run 1, Latest"):
        history(path, columns=columns, run="Run 2")
    with pytest.raises(ValueError, match=r"Run 1': Column 'Force .N.' may be the contact force"):
        history(path)
    with pytest.raises(
        ValueError, match=r"There are several runs: 'Run 1', 'Latest'. Say which: ru"
    ):
        read_drive(path, quantity="force")
    assert_allclose(read_drive(path, quantity="force", run="Run 1").values, -0.5 * np.arange(40))


@pytest.mark.parametrize(("name", "write"), [("a.csv", write_csv), ("a.xlsx", write_workbook)])
def test_slower_channels_have_gaps(tmp_path, name, write):
    path = write(tmp_path / name, ROWS)
    columns = dict(contact_force="Force (N)")
    how = dict(initial_velocity=0.1, gain=dict(contact_force=-1.0), run="Latest")
    read = read_measured_history(path, columns=columns, **how)
    assert_array_equal(np.flatnonzero(np.isfinite(read.displacement)), 4 * np.arange(5))
    assert np.isfinite(read.contact_force).all()
    assert "displacement was sampled in 5 of 20 rows." in read.notes
    assert not said(read.notes, "positive in contact here")
    plain = history(path, columns=columns, run="Latest")
    assert said(plain.notes, "The contact force goes down to -4.75 N: it is positive in contact")
    assert (read.gain, read.initial_velocity) == (dict(contact_force=-1.0), 0.1)
    # Without the force, rows without a position hold nothing.
    alone = dict(columns=dict(contact_force=None), run="Latest")
    assert_allclose(history(path, **alone).displacement, 0.08 * np.arange(5))
    assert said(history(path, **alone).notes, "15 unusable rows left out: ")
    with pytest.raises(ValueError, match=r"15 unusable rows: .* 3 \(no sample\)"):
        history(path, **alone, skip_unusable=False)


def test_names_of_runs_behind_the_names_of_columns(tmp_path):
    header = ["time (s) Run #1", "tip (mm) Run #1", "time (s) Run #2", "tip (mm) Run #2"]
    path = write_csv(tmp_path / "a.csv", [header, [0, 1, 0, 2], [1, 2, 1, 4]])
    assert [one.label for one in history(path)] == ["a, Run #1", "a, Run #2"]
    shared = {"time_s": [0, 1], "Run 1: tip_mm": [1, 2], "Run 2: tip_mm": [2, 4]}
    assert_allclose(history(shared, run="Run 2").displacement, [2e-3, 4e-3])
    # Channels are no runs, nor is a colon alone.
    with pytest.raises(ValueError, match="No column for the displacement"):
        history({"time_s": [0, 1], "ch1: tip_mm": [1, 2], "ch2: tip_mm": [2, 4]})
    curves = read_measured_curve(
        {
            "Up: f [Hz]": [8, 9],
            "Up: tip [mm]": [1, 2],
            "Down: f [Hz]": [9, 8],
            "Down: tip [mm]": [2, 1],
        }
    )
    assert [curve.label for curve in curves] == ["Up", "Down"]
    assert curves[1].backward.all()


def test_sheets_titles_units_below_and_merged_headers(tmp_path):
    rows = [["Bench 3"], [], ["time", None, "tip"], ["s", None, "mm"], [0, None, 1], [1, None, 2]]
    path = write_workbook(tmp_path / "a.xlsx", rows, {"notes": [["by", "me"]], "empty": []})
    read = history(path)
    assert_allclose(read.displacement, [1e-3, 2e-3])
    assert said(read.notes, "Units are those of row 4.")
    two = write_workbook(tmp_path / "two.xlsx", rows, {"run2": rows})
    with pytest.raises(ValueError, match=r"has 2 sheets: 'run1', 'run2'. Say which: at='run1'"):
        history(two)
    assert said(history(two, at="run2").notes, "Read from sheet 'run2'.")
    merged = [["Run 1", None, "Run 2", None], ["t_s", "tip_mm"] * 2, [0, 1, 0, 2], [1, 2, 1, 4]]
    path = write_workbook(tmp_path / "merged.xlsx", merged)
    assert_allclose(history(path, run="Run 2").displacement, [2e-3, 4e-3])
    commas = [["t_s", "tip_mm"], [0, "0,25"], [1, "1,5"]]
    assert_allclose(
        history(write_workbook(tmp_path / "c.xlsx", commas)).displacement, [0.25e-3, 1.5e-3]
    )
    text = write_csv(tmp_path / "units.csv", [["time", "tip"], ["[s]", "[mm]"], [0, 1], [1, 2]])
    assert_allclose(history(text).displacement, [1e-3, 2e-3])
    assert_array_equal(read_table(text).lines, [3, 4])
    other = write_csv(tmp_path / "units.csv", [["t_s", "tip_mm"], ["s", "m"], [0, 1], [1, 2]])
    with pytest.raises(ValueError, match="has the unit 'mm' in its name and 'm' beside it"):
        history(other)


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("spacing", [0, 1])
def test_frequency_responses_of_universal_files(tmp_path, binary, order, spacing):
    kinds = ((8, "mm", 1e-3), (11, "m/s", 1.0), (12, "g", 9.80665))
    kind, unit, factor = kinds[order]
    data = RESPONSE * (2j * np.pi * FREQUENCY) ** order / factor
    fields = dict(ordinate_spec_data_type=kind, ordinate_axis_units_lab=unit)
    frf = FRF | fields | dict(x=FREQUENCY, data=data, binary=binary, abscissa_spacing=spacing)
    path = write_uff(tmp_path / "a.uff", [frf])
    curve = read_measured_curve(path)
    assert_allclose(curve.frequency, FREQUENCY, rtol=1e-5)
    assert_allclose(curve.amplitude, abs(RESPONSE), rtol=1e-5)
    assert_allclose(curve.phase, np.angle(RESPONSE), atol=1e-5)
    assert (curve.quantity, curve.is_ratio) == ("first_harmonic", True)
    assert said(curve.notes, "Read from record 1, a frequency response")
    one_label = frf | dict(ordinate_axis_units_lab=f"{unit}/N", orddenom_axis_units_lab="NONE")
    curve = read_measured_curve(write_uff(path, [one_label]))
    assert_allclose(curve.amplitude, abs(RESPONSE), rtol=1e-5)


def test_units_of_a_universal_file_and_transmissibilities(tmp_path):
    millimetres = dict(type=164, units_code=5, length=1e3, force=1e3, temp=1.0, temp_offset=273.15)
    bare = dict(ordinate_axis_units_lab="NONE", orddenom_axis_units_lab="NONE")
    frf = FRF | bare | dict(x=FREQUENCY, data=RESPONSE)
    with pytest.raises(ValueError, match="says no unit of the amplitude"):
        read_measured_curve(write_uff(tmp_path / "a.uff", [frf]))
    curve = read_measured_curve(write_uff(tmp_path / "a.uff", [millimetres, frf]))
    assert_allclose(curve.amplitude, abs(RESPONSE), rtol=1e-5)
    moved = dict(func_type=5, orddenom_spec_data_type=12, orddenom_axis_units_lab="g")
    both = FRF | moved | dict(ordinate_spec_data_type=12, ordinate_axis_units_lab="g")
    curve = read_measured_curve(
        write_uff(tmp_path / "a.uff", [both | dict(x=FREQUENCY, data=RESPONSE)]), frame="absolute"
    )
    assert_allclose(curve.amplitude, abs(RESPONSE), rtol=1e-5)
    spectrum = FRF | dict(func_type=12, x=FREQUENCY, data=RESPONSE, orddenom_spec_data_type=0)
    curve = read_measured_curve(write_uff(tmp_path / "a.uff", [spectrum]))
    assert_allclose(curve.amplitude, 1e-3 * abs(RESPONSE), rtol=1e-5)
    assert said(curve.notes, "not for rms")


def test_time_responses_of_universal_files(tmp_path):
    tip = RECORD | dict(x=TIME, data=TIP, abscissa_spacing=1)
    force = dict(ordinate_spec_data_type=13, ordinate_axis_units_lab="N")
    slow = tip | force | dict(x=TIME[::4], data=2 * TIP[::4])
    path = write_uff(tmp_path / "a.uff", [tip, slow, FRF | dict(x=FREQUENCY, data=RESPONSE)])
    table = read_table(path, along="time")
    assert_array_equal(np.flatnonzero(np.isfinite(table.columns["excitation force"])) % 4, 0)
    assert_allclose(history(path).displacement, 1e-3 * TIP, atol=1e-15)
    assert_allclose(read_drive(path, quantity="force", at=2).values, 2 * TIP[::4])
    assert read_measured_curve(path).size == 41
    beside = write_uff(tmp_path / "b.uff", [tip, tip | dict(rsp_node=4)])
    with pytest.raises(ValueError, match=r"No column for the displacement.*'displacement 4\+Z'"):
        history(beside)


def test_netcdf_has_groups(tmp_path):
    import xarray

    tip = xarray.Dataset({"tip": ("time", TIP, {"units": "mm"})}, {"time": TIME})
    tip.to_netcdf(tmp_path / "a.nc", engine="h5netcdf", group="bench/run1")
    assert_allclose(history(tmp_path / "a.nc", at="bench/run1").displacement, 1e-3 * TIP)


@pytest.mark.parametrize(
    ("library", "name"),
    [("nptdms", "a.tdms"), ("pyuff", "a.uff"), ("python_calamine", "a.xlsx")],
)
def test_a_library_that_is_missing_is_named(tmp_path, monkeypatch, library, name):
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / name).write_bytes(b"PK\x03\x04" if name == "a.xlsx" else b"")
    with pytest.raises(ImportError, match=r'is not installed\. .*pip install "vibrojax.formats."'):
        history(tmp_path / name)


def test_units_that_contradict_each_other_are_asked_about(tmp_path):
    path = written_files.write_hdf5(tmp_path / "a.h5", {"time_s": TIME, "tip_mm": (TIP, "m")})
    with pytest.raises(ValueError, match="has the unit 'mm' in its name and 'm' beside it"):
        history(path)
    assert_allclose(history(path, units=dict(displacement="mm")).displacement, 1e-3 * TIP)


def test_a_place_is_of_files_that_have_several(tmp_path):
    path = write_csv(tmp_path / "a.csv", [["t_s", "tip_mm"], [0, 1], [1, 2]])
    with pytest.raises(ValueError, match=r"'a.csv' has one table, as text: leave out at='x'"):
        history(path, at="x")
    with pytest.raises(ValueError, match="at='x' is a place in a file, and source is a dict"):
        history({"t_s": [0, 1], "tip_mm": [1, 2]}, at="x")


def test_the_public_surface_reads_a_workbook(tmp_path):
    path = tmp_path / "a.xlsx"
    workbook = openpyxl.Workbook()
    for row in (["f [Hz]", "tip [mm]"], [8.0, 1.0], [9.0, 2.0]):
        workbook.active.append(row)
    workbook.save(path)
    assert vj.io.read_measured_curve(path).size == 2


def test_mat_files_of_version_4(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIME, "tip_mm": TIP}, format="4")
    assert_allclose(history(tmp_path / "a.mat").displacement, 1e-3 * TIP)
