"""Writers of one table in files of several formats: of nested dicts, of rows, of records."""

import warnings

import h5py
import numpy as np
import scipy.io
from nptdms import ChannelObject, TdmsWriter


def write_mat(path, tree):
    """MAT 5; a unit is a field beside the values."""

    def plain(item):
        if isinstance(item, tuple):
            return {"values": item[0], "units": item[1]}
        return {n: plain(v) for n, v in item.items()} if isinstance(item, dict) else item

    scipy.io.savemat(path, {n: plain(v) for n, v in tree.items()}, long_field_names=True)
    return path


def write_hdf5(path, tree):
    """HDF5; a unit is an attribute."""

    def put(group, own):
        for name, item in own.items():
            if isinstance(item, dict):
                put(group.create_group(name), item)
                continue
            values, unit = item if isinstance(item, tuple) else (item, None)
            if isinstance(values, np.ndarray) and values.dtype.kind in "UO":
                values = values.astype(h5py.string_dtype())
            group[name] = values
            if unit:
                group[name].attrs["units"] = unit

    with h5py.File(path, "w") as file:
        put(file, tree)
    return path


def write_mat_73(path, tree):
    """MAT 7.3 as MATLAB writes it: HDF5 behind 512 bytes, columns as rows, text as numbers.

    Lists are arrays of structs, with references.
    """

    def array(group, name, values):
        if isinstance(values, str):
            item = group.create_dataset(name, data=np.array([[ord(c)] for c in values], "uint16"))
            item.attrs["MATLAB_class"] = np.bytes_("char")
            return
        values = np.asarray(values)
        if values.dtype.kind in "UO":
            cells = [group.file.require_group("#refs#") for _ in values]
            names = [f"{name}{k}" for k in range(len(values))]
            for cell, inner, text in zip(cells, names, values, strict=True):
                array(cell, inner, str(text))
            found = [cell[inner].ref for cell, inner in zip(cells, names, strict=True)]
            item = group.create_dataset(name, data=np.array([found], h5py.ref_dtype))
            item.attrs["MATLAB_class"] = np.bytes_("cell")
            return
        if values.dtype.kind == "c":
            pairs = np.zeros(values.shape, [("real", float), ("imag", float)])
            pairs["real"], pairs["imag"] = values.real, values.imag
            values = pairs
        item = group.create_dataset(
            name, data=np.atleast_2d(values if values.ndim < 2 else values.T)
        )
        item.attrs["MATLAB_class"] = np.bytes_("double")

    def put(group, name, item):
        if isinstance(item, tuple):
            item = {"values": item[0], "units": item[1]}
        if isinstance(item, list):
            inside = group.create_group(name)
            inside.attrs["MATLAB_class"] = np.bytes_("struct")
            heap = group.file.require_group("#refs#")
            for field in item[0]:
                for k, one in enumerate(item):
                    put(heap, f"{name}{field}{k}", one[field])
                found = [heap[f"{name}{field}{k}"].ref for k in range(len(item))]
                inside.create_dataset(field, data=np.array([found], h5py.ref_dtype))
        elif isinstance(item, dict):
            inside = group.create_group(name)
            inside.attrs["MATLAB_class"] = np.bytes_("struct")
            for field, one in item.items():
                put(inside, field, one)
        else:
            array(group, name, item)

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, item in tree.items():
            put(file, name, item)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    return path


def write_tdms(path, tree):
    """TDMS; a dict besides dicts is of waveform properties, as (array, unit, properties)."""
    channels = []
    for group, own in tree.items():
        for name, item in own.items():
            values, *rest = item if isinstance(item, tuple) else (item,)
            properties = dict(rest[1]) if len(rest) > 1 else {}
            if rest and rest[0]:
                properties["unit_string"] = rest[0]
            values = np.asarray(values)
            values = values.astype(str) if values.dtype.kind == "O" else values
            channels.append(ChannelObject(group, name, values, properties))
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)
    return path


def write_csv(path, rows, sheets=None):
    """Text with semicolons between cells."""
    path.write_text("".join(";".join(_cell(c) for c in row) + "\n" for row in rows))
    return path


def _cell(cell):
    return "" if cell is None else str(cell)


def write_workbook(path, rows, sheets=None):
    """A workbook of Excel; `sheets` are further ones, by name."""
    import openpyxl

    workbook = openpyxl.Workbook()
    workbook.active.title = "run1"
    for name, own in {"run1": rows, **(sheets or {})}.items():
        sheet = workbook[name] if name in workbook.sheetnames else workbook.create_sheet(name)
        for row in own:
            sheet.append(list(row))
    workbook.save(path)
    return path


FRF = dict(
    type=58, func_type=4, rsp_node=3, rsp_dir=3, ref_node=1, ref_dir=3, binary=0,
    abscissa_spacing=0, abscissa_spec_data_type=18, abscissa_axis_units_lab="Hz",
    ordinate_spec_data_type=8, ordinate_axis_units_lab="mm",
    orddenom_spec_data_type=13, orddenom_axis_units_lab="N",
    z_axis_spec_data_type=0,
)  # fmt: skip
"""Fields of a frequency response; `x` and `data` are missing."""
RECORD = FRF | dict(
    func_type=1, abscissa_spec_data_type=17, abscissa_axis_units_lab="s",
    orddenom_spec_data_type=0, orddenom_axis_units_lab="NONE",
)  # fmt: skip
"""Fields of a time response."""


def write_uff(path, records):
    """A universal file of some data sets."""
    import pyuff

    alone, written = path.with_suffix(".one"), b""
    for record in records:
        # Of binary sets pyuff leaves a file open, and not all functions does it write.
        alone.unlink(missing_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind = record.get("func_type", 0)
            pyuff.UFF(str(alone)).write_sets(record | dict(func_type=min(kind, 4)), "add")
        lines = alone.read_bytes().split(b"\n")
        if record["type"] == 58:
            lines[7] = b"%5d" % kind + lines[7][5:]
        written += b"\n".join(lines)
    path.write_bytes(written)
    return path
