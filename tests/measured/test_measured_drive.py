"""Drives read from records: columns, units, forces, refusals."""

import numpy as np
import pytest

import vibrojax as vj

TIME = np.arange(5) * 1e-3
SIGNAL = np.array([0.0, 1.0, -2.0, 0.5, 0.25])


def written(path, header, *columns, rows=""):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    path.write_text(path.read_text() + rows)
    return path


def test_units_of_the_header(tmp_path):
    path = written(tmp_path / "a.csv", "time [ms],base acceleration [g]", 1e3 * TIME, SIGNAL)
    drive = vj.io.read_drive(path)
    np.testing.assert_allclose(drive.time, TIME, atol=1e-15)
    np.testing.assert_allclose(drive.values, 9.80665 * SIGNAL)
    assert drive.equally_spaced


def test_a_force_beside_an_acceleration(tmp_path):
    header = "t [s],acceleration [m/s2],F [N]"
    path = written(tmp_path / "a.csv", header, TIME, SIGNAL, 3 * SIGNAL)
    np.testing.assert_allclose(vj.io.read_drive(path).values, SIGNAL)
    force = vj.io.read_drive(path, quantity="force")
    np.testing.assert_allclose(force.values, 3 * SIGNAL)


@pytest.mark.parametrize(
    ("header", "rows", "arguments", "message"),
    [
        ("time [s],acceleration", "", {}, "says no unit of the acceleration. Give it: units=dict"),
        ("time [s],tip [m]", "", {}, "No column for the acceleration"),
        ("time [s],acceleration [g]", "0.006,oops\n", {}, "1 unusable row"),
        ("time [s],acceleration [g]", "0.001,1\n", {}, "time must rise"),
        ("time [s],acceleration [g]", "", {"units": {"force": "N"}}, "unknown key 'force'"),
        ("time [s],acceleration [g]", "", {"quantity": "velocity"}, "quantity must be one of"),
    ],
)
def test_what_is_no_drive_is_refused(tmp_path, header, rows, arguments, message):
    path = written(tmp_path / "a.csv", header, TIME, SIGNAL, rows=rows)
    with pytest.raises(ValueError, match=message):
        vj.io.read_drive(path, **arguments)
