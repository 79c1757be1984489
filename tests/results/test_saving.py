"""Every `save`: the whole file or none, and what was there before stays."""

import errno
import importlib
import inspect
import json
import os
import pkgutil
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

import vibrojax
from vibrojax.results import saving


def classes_that_save():
    found = {}
    for module in pkgutil.walk_packages(vibrojax.__path__, "vibrojax."):
        members = inspect.getmembers(importlib.import_module(module.name), inspect.isclass)
        found |= {name: one for name, one in members if hasattr(one, "save")}
    return found


CLASSES = {n: c for n, c in classes_that_save().items() if c.__module__.startswith("vibrojax")}


class Figure:
    def savefig(self, path, **settings):
        path.write_bytes(b"new picture")


def result(values=200_000):
    """As much of a result as its `save` asks for."""
    return SimpleNamespace(
        to_xarray=lambda: xarray.Dataset({"a": ("x", np.random.default_rng(0).random(values))}),
        to_dict=lambda: {"numbers": list(range(values))},
        plot=Figure,
        figure=lambda *frequency, **numbers: Figure(),
    )


def names(name, folder):
    """Return the path for a class, and the files that its save writes."""
    files = {"Identification": ["x.json", "x.png"], "Explorer": ["x.png"]}.get(name, ["x.nc"])
    return folder / files[0], [folder / file for file in files]


def test_all_results_that_save_are_known():
    assert {"Branch", "SingleContactResponse", "FrequencyResponse", "Identification"} <= {*CLASSES}


@pytest.mark.parametrize("name", CLASSES)
def test_a_file_is_written_whole(tmp_path, name):
    path, files = names(name, tmp_path)
    CLASSES[name].save(result(), path)
    assert sorted(tmp_path.iterdir()) == sorted(files)
    if path.suffix == ".nc":
        with xarray.open_dataset(path, engine="h5netcdf") as read:
            assert read.identical(result().to_xarray())
    elif path.suffix == ".json":
        assert json.loads(path.read_text()) == result().to_dict()
    assert all(file.stat().st_mode & 0o777 == 0o666 & ~umask() for file in files)


def umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("failure", ["full disk", "interrupted", "no rename"])
def test_what_was_there_stays_where_writing_fails(tmp_path, monkeypatch, name, failure):
    path, files = names(name, tmp_path)
    for file in files:
        file.write_bytes(b"old")

    def fail(*arguments):
        if failure == "interrupted":
            raise KeyboardInterrupt
        raise OSError(errno.ENOSPC, "No space left on device")

    function = "replace" if failure == "no rename" else "fsync"
    monkeypatch.setattr(saving.os, function, fail)
    with pytest.raises((OSError, KeyboardInterrupt)) as caught:
        CLASSES[name].save(result(), path)
    if failure != "interrupted":
        assert caught.value.errno == errno.ENOSPC
        assert "No space left on device; what was there before stays" in str(caught.value)
        assert all(str(file) in str(caught.value) for file in files)
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(file.read_bytes() == b"old" for file in files)


@pytest.mark.parametrize("name", CLASSES)
def test_paths_that_cannot_be_files(tmp_path, name):
    path, _ = names(name, tmp_path)
    folder = tmp_path / f"folder{path.suffix}"
    folder.mkdir()
    for wrong, sentence in (
        (folder, "is a folder"),
        (tmp_path / "none" / path.name, "The folder of path .* does not exist: make it first"),
        ("", "path must be the path of a file, got ''"),
        ("x\0", "path must be the path of a file"),
    ):
        with pytest.raises(ValueError, match=sentence):
            CLASSES[name].save(result(3), wrong)
    assert list(tmp_path.iterdir()) == [folder]


def test_a_disk_without_room_does_not_end_the_process(tmp_path):
    resource = pytest.importorskip("resource")
    signal = importlib.import_module("signal")
    path = tmp_path / "x.nc"
    path.write_bytes(b"old")
    dataset = result().to_xarray()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (5000, before[1]))
        with pytest.raises(OSError, match="what was there before stays"):
            saving.save_dataset(dataset, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"old"


def test_links_are_followed_and_other_formats_refused(tmp_path):
    dataset = result(3).to_xarray()
    (tmp_path / "link.nc").symlink_to(tmp_path / "x.nc")
    saving.save_dataset(dataset, tmp_path / "link.nc")
    assert (tmp_path / "link.nc").is_symlink()
    assert (tmp_path / "x.nc").is_file()
    with pytest.raises(ValueError, match=r"must end in .nc, as NetCDF is written, got .*curve.csv"):
        saving.save_dataset(dataset, tmp_path / "curve.csv")
    with pytest.raises(ValueError, match="is a pipe or a device"):
        saving.save_dataset(dataset, os.devnull)
