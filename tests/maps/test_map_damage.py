"""Stores that were damaged, in forty ways and more: the same call repairs them and says what."""

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
from map_program import make_map
from test_map_interrupted import Fragile, assert_same_store

import vibrojax as vj

LANES, CHUNKS = 6, 3
VARIABLE = "amplitude_ratio"


def small_map(store, **more):
    """Three chunks of two lanes, with curves and a measure."""
    few = {"measures": ["natural_frequency"], "keep_curves": True, "chunk_lanes": 2}
    return make_map(store, LANES, **(few | more))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A store that nothing happened to."""
    place = tmp_path_factory.mktemp("whole") / "map"
    small_map(place)
    return place


@pytest.fixture
def store(tmp_path, whole):
    """A copy of it, to be damaged."""
    return shutil.copytree(whole, tmp_path / "map")


# --------------------------------------------------------------------------- ways of damage


def flip(file, bit=0, at=None):
    """Flip one bit of a file, by default in its middle."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2 if at is None else at] ^= 1 << bit
    file.write_bytes(data)


def truncate(file):
    file.write_bytes(file.read_bytes()[:-3])


def empty(file):
    file.write_bytes(b"")


def longer(file):
    file.write_bytes(file.read_bytes() + b"\0")


def delete(path):
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def into_folder(path):
    delete(path)
    path.mkdir()


def into_file(path):
    delete(path)
    path.write_text("no folder")


def swap(first, second):
    data = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(data)


def edit(file, change):
    """Change what a file of JSON holds."""
    whole = json.loads(file.read_bytes())
    change(whole)
    file.write_text(json.dumps(whole, indent=2))


def without(*names):
    """Return an edit that removes something."""

    def change(whole):
        for name in names[:-1]:
            whole = whole[name]
        del whole[names[-1]]

    return change


def with_value(value, *names):
    """Return an edit that sets something."""

    def change(whole):
        for name in names[:-1]:
            whole = whole[name]
        whole[names[-1]] = value

    return change


def chunk(store, name=VARIABLE, number=1):
    place = store / name / "c" / f"{number}"
    return next(p for p in [place, *sorted(place.rglob("*"))] if p.is_file())


def every_file_of_chunk(store, number):
    files = [p for p in store.glob(f"*/c/{number}/**/*") if p.is_file()]
    return [*files, *(p for p in store.glob(f"*/c/{number}") if p.is_file())]


def copy_chunk_with_record(store):
    """Chunk 0 in place of chunk 1: all files agree with their record, but not with their place."""
    for file in every_file_of_chunk(store, 0):
        parts = list(file.relative_to(store).parts)
        if parts[0] in ("natural", "frequency_ratio", "direction"):
            continue
        parts[2] = "1"
        shutil.copy(file, store.joinpath(*parts))
    shutil.copy(store / "vibrojax/chunks/0.json", store / "vibrojax/chunks/1.json")


ROOT, COPY = "zarr.json", "vibrojax/map.json"
RECORD = "vibrojax/chunks/1.json"
CHUNK = r"chunk 1 at natural\[2:4\]"
AGAIN = "1 of 3 chunks are computed again"
ALL = "3 of 3 chunks are computed again"
WRITTEN = "What the call itself knows was written again"

DAMAGES = {
    # the chunks of data
    "data chunk deleted": (lambda s: delete(chunk(s)), [CHUNK, VARIABLE, "missing", AGAIN]),
    "data chunk truncated": (lambda s: truncate(chunk(s)), [CHUNK, VARIABLE, "changed", AGAIN]),
    "data chunk emptied": (lambda s: empty(chunk(s)), [CHUNK, VARIABLE, AGAIN]),
    "data chunk longer": (lambda s: longer(chunk(s)), [CHUNK, VARIABLE, AGAIN]),
    "bit of a data chunk": (lambda s: flip(chunk(s)), [CHUNK, VARIABLE, AGAIN]),
    "first bit of a data chunk": (lambda s: flip(chunk(s), 0, 0), [CHUNK, VARIABLE, AGAIN]),
    "bit of a checksum": (lambda s: flip(chunk(s), 7, -1), [CHUNK, VARIABLE, AGAIN]),
    "data chunk a folder": (lambda s: into_folder(chunk(s)), [CHUNK, VARIABLE, AGAIN]),
    "folder of a data chunk a file": (
        lambda s: into_file(s / VARIABLE / "c" / "1"),
        [CHUNK, VARIABLE, AGAIN],
    ),
    "folder of a data chunk deleted": (lambda s: delete(s / VARIABLE / "c" / "1"), [CHUNK, AGAIN]),
    "data chunks swapped": (
        lambda s: swap(chunk(s, number=0), chunk(s, number=2)),
        ["chunk 0", "chunk 2", "2 of 3 chunks"],
    ),
    "data chunk copied": (
        lambda s: shutil.copy(chunk(s, number=0), chunk(s, number=1)),
        [CHUNK, VARIABLE, AGAIN],
    ),
    "chunks of two variables swapped": (
        lambda s: swap(chunk(s), chunk(s, "peak_ratio")),
        [CHUNK, VARIABLE, "peak_ratio", AGAIN],
    ),
    "whole chunk copied with its record": (copy_chunk_with_record, [CHUNK, "record", AGAIN]),
    "all chunks of a variable deleted": (lambda s: delete(s / VARIABLE / "c"), [VARIABLE, ALL]),
    "chunk of a measure deleted": (
        lambda s: delete(chunk(s, "natural_frequency")),
        [CHUNK, "natural_frequency", AGAIN],
    ),
    "lane_status of a chunk deleted": (
        lambda s: delete(chunk(s, "lane_status")),
        [CHUNK, "lane_status", AGAIN],
    ),
    "bit of lane_status": (lambda s: flip(chunk(s, "lane_status")), [CHUNK, "lane_status", AGAIN]),
    "lane_status swapped": (
        lambda s: swap(chunk(s, "lane_status"), chunk(s, "lane_steps")),
        [CHUNK, "lane_status", "lane_steps", AGAIN],
    ),
    # records
    "record deleted": (lambda s: delete(s / RECORD), [CHUNK, "missing", AGAIN]),
    "record no JSON": (lambda s: flip(s / RECORD, 6, 0), [CHUNK, "record", AGAIN]),
    "record of other numbers": (
        lambda s: edit(s / RECORD, with_value("00", "files", VARIABLE)),
        [CHUNK, VARIABLE, AGAIN],
    ),
    "record without its files": (
        lambda s: edit(s / RECORD, without("files")),
        [CHUNK, "record", AGAIN],
    ),
    "record a list": (lambda s: (s / RECORD).write_text("[1]"), [CHUNK, "record", AGAIN]),
    "record a folder": (lambda s: into_folder(s / RECORD), [CHUNK, "record", AGAIN]),
    "all records deleted": (lambda s: delete(s / "vibrojax/chunks"), ["chunk 0", ALL]),
    "folder of records deleted": (lambda s: delete(s / "vibrojax"), ["vibrojax", ALL]),
    "folder of records a file": (lambda s: into_file(s / "vibrojax"), ["vibrojax", ALL]),
    # coordinates
    "coordinate deleted": (lambda s: delete(s / "natural"), ["natural", WRITTEN]),
    "values of a coordinate deleted": (lambda s: delete(s / "natural/c"), ["natural", WRITTEN]),
    "bit of a coordinate": (lambda s: flip(s / "natural/c/0"), ["natural", WRITTEN]),
    "coordinate truncated": (lambda s: truncate(s / "frequency_ratio/c/0"), ["frequency_ratio"]),
    "text coordinate deleted": (lambda s: delete(s / "direction/c"), ["direction", WRITTEN]),
    "coordinate a file": (lambda s: into_file(s / "natural"), ["natural", WRITTEN]),
    "values of a coordinate replaced": (
        lambda s: shutil.copy(s / "frequency_ratio/c/0", s / "natural/c/0"),
        ["natural", WRITTEN],
    ),
    # what describes the arrays
    "description deleted": (lambda s: delete(s / VARIABLE / ROOT), [VARIABLE, WRITTEN]),
    "description emptied": (lambda s: empty(s / VARIABLE / ROOT), [VARIABLE, WRITTEN]),
    "description no JSON": (lambda s: flip(s / VARIABLE / ROOT, 5, 0), [VARIABLE, WRITTEN]),
    "description no text": (lambda s: flip(s / VARIABLE / ROOT, 7, 40), [VARIABLE, WRITTEN]),
    "other shape": (
        lambda s: edit(s / VARIABLE / ROOT, with_value([6, 1, 4], "shape")),
        [VARIABLE, WRITTEN],
    ),
    "other type": (
        lambda s: edit(s / VARIABLE / ROOT, with_value("int64", "data_type")),
        [VARIABLE, WRITTEN],
    ),
    "other fill value": (
        lambda s: edit(s / "lane_status" / ROOT, with_value(0, "fill_value")),
        ["lane_status", WRITTEN],
    ),
    "other codecs": (
        lambda s: edit(s / VARIABLE / ROOT, lambda w: w["codecs"].pop()),
        [VARIABLE, WRITTEN],
    ),
    "other chunks": (
        lambda s: edit(
            s / "lane_status" / ROOT,
            with_value([3], "chunk_grid", "configuration", "chunk_shape"),
        ),
        ["lane_status", WRITTEN],
    ),
    "no chunks": (
        lambda s: edit(s / "lane_status" / ROOT, without("chunk_grid")),
        ["lane_status", WRITTEN],
    ),
    "other units": (
        lambda s: edit(s / VARIABLE / ROOT, with_value("mm", "attributes", "units")),
        [VARIABLE, WRITTEN],
    ),
    "other dimensions": (
        lambda s: edit(s / VARIABLE / ROOT, with_value(["a", "b", "c"], "dimension_names")),
        [VARIABLE, WRITTEN],
    ),
    "description of another array": (
        lambda s: shutil.copy(s / "lane_steps" / ROOT, s / VARIABLE / ROOT),
        [VARIABLE, WRITTEN],
    ),
    "description a folder": (lambda s: into_folder(s / VARIABLE / ROOT), [VARIABLE, WRITTEN]),
    "variable deleted": (lambda s: delete(s / VARIABLE), [VARIABLE, WRITTEN, ALL]),
    "lane_status deleted": (lambda s: delete(s / "lane_status"), ["lane_status", ALL]),
    "variable a file": (lambda s: into_file(s / VARIABLE), [VARIABLE, WRITTEN, ALL]),
    # what describes the whole
    "root deleted": (lambda s: delete(s / ROOT), [ROOT, WRITTEN]),
    "root emptied": (lambda s: empty(s / ROOT), [ROOT, WRITTEN]),
    "root truncated": (lambda s: truncate(s / ROOT), [ROOT, WRITTEN]),
    "root a folder": (lambda s: into_folder(s / ROOT), [ROOT, WRITTEN]),
    "root no JSON": (lambda s: flip(s / ROOT, 5, 0), [ROOT, WRITTEN]),
    "root nests too deep": (lambda s: (s / ROOT).write_text("[" * 99_999), [ROOT, WRITTEN]),
    "root without attributes": (lambda s: edit(s / ROOT, without("attributes")), [ROOT, WRITTEN]),
    "attributes a list": (lambda s: edit(s / ROOT, with_value([], "attributes")), [ROOT, WRITTEN]),
    "root without settings": (
        lambda s: edit(s / ROOT, without("attributes", "vibrojax_map")),
        [ROOT, WRITTEN],
    ),
    "root without chunks": (
        lambda s: edit(s / ROOT, without("attributes", "block")),
        [ROOT, WRITTEN],
    ),
    "other chunks in the root": (
        lambda s: edit(s / ROOT, with_value("[3]", "attributes", "block")),
        [ROOT, WRITTEN],
    ),
    "other title": (
        lambda s: edit(s / ROOT, with_value("vibrojax parameter map.", "attributes", "title")),
        [ROOT, WRITTEN],
    ),
    "other source": (
        lambda s: edit(s / ROOT, with_value("def rig()", "attributes", "rig_source")),
        [ROOT, WRITTEN],
    ),
    "attribute of another name": (
        lambda s: edit(s / ROOT, lambda w: w["attributes"].update(sumnary="")),
        None,  # like one of the user's, which is no damage
    ),
    "summary of another name": (
        lambda s: edit(
            s / ROOT, lambda w: w["attributes"].update(rummary=w["attributes"].pop("summary"))
        ),
        [ROOT, WRITTEN],
    ),
    "root an array": (lambda s: shutil.copy(s / VARIABLE / ROOT, s / ROOT), [ROOT, WRITTEN]),
    "root of another format": (
        lambda s: edit(s / ROOT, with_value(2, "zarr_format")),
        [ROOT, WRITTEN],
    ),
    "no consolidated metadata": (
        lambda s: edit(s / ROOT, without("consolidated_metadata")),
        [ROOT, WRITTEN],
    ),
    "other consolidated metadata": (
        lambda s: edit(
            s / ROOT,
            with_value([1], "consolidated_metadata", "metadata", VARIABLE, "shape"),
        ),
        [ROOT, WRITTEN],
    ),
    "settings of another map": (
        lambda s: edit(
            s / ROOT,
            lambda w: w["attributes"].update(
                vibrojax_map=w["attributes"]["vibrojax_map"].replace("1.2", "1.3")
            ),
        ),
        [ROOT, WRITTEN],
    ),
    "settings no JSON": (
        lambda s: edit(s / ROOT, with_value("{", "attributes", "vibrojax_map")),
        [ROOT, WRITTEN],
    ),
    "copy deleted": (lambda s: delete(s / COPY), [COPY, WRITTEN]),
    "copy no JSON": (lambda s: flip(s / COPY, 5, 0), [COPY, WRITTEN]),
    "copy of other values": (
        lambda s: edit(s / COPY, with_value("[3]", "attributes", "block")),
        [COPY, WRITTEN],
    ),
    "group of records deleted": (lambda s: delete(s / "vibrojax" / ROOT), ["vibrojax", WRITTEN]),
    # several at once
    "root and a chunk": (
        lambda s: (delete(s / ROOT), flip(chunk(s))),
        [ROOT, CHUNK, VARIABLE, WRITTEN, AGAIN],
    ),
    "everything of a chunk deleted": (
        lambda s: [delete(p) for p in [*every_file_of_chunk(s, 1), s / RECORD]],
        ["natural.1.|chunk 1", AGAIN],
    ),
}


QUICK = (
    "data chunk deleted",
    "bit of a data chunk",
    "data chunks swapped",
    "record deleted",
    "values of a coordinate deleted",
    "other fill value",
    "variable deleted",
    "root truncated",
    "root without settings",
    "settings of another map",
    "copy of other values",
    "root and a chunk",
)
"""Ways that are tried on every run; CI tries all."""


@pytest.mark.parametrize(
    "damage", [pytest.param(d, marks=() if d in QUICK else pytest.mark.slow) for d in DAMAGES]
)
def test_a_damaged_store_is_repaired_by_the_same_call_which_says_what_was_wrong(
    store, whole, damage
):
    harm, words = DAMAGES[damage]
    harm(store)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = small_map(store)
    if words is None:
        assert caught == []
        return
    (warning,) = caught  # one sentence, which names all of it
    text = str(warning.message)
    assert text.startswith(f"store: {str(store)!r} was damaged: ")
    for word in words:
        assert any(part in text.replace("\\", "") for part in word.replace("\\", "").split("|"))
    found.close()
    assert_same_store(store, whole)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        small_map(store)


REFUSED = {
    "both copies of the settings": (
        lambda s: (empty(s / ROOT), empty(s / COPY)),
        "is there already and is not a store of a map",
    ),
    "settings no JSON, and no copy of them": (
        lambda s: (
            edit(s / ROOT, with_value("{", "attributes", "vibrojax_map")),
            delete(s / COPY),
        ),
        "is damaged: neither its zarr.json nor the copy of it can be read",
    ),
}


@pytest.mark.parametrize("damage", REFUSED)
def test_what_cannot_be_read_at_all_is_refused_with_what_to_do(store, damage):
    harm, sentence = REFUSED[damage]
    harm(store)
    with pytest.raises(ValueError, match=sentence):
        small_map(store)


@pytest.mark.slow
def test_any_bit_of_any_file_may_flip(tmp_path, whole):
    # Everything of the store is known by something else: there is no file in which a bit may flip
    # unnoticed. (Spaces of JSON aside, where it is still the same JSON.)
    choice = np.random.default_rng(5)
    files = sorted(p.relative_to(whole) for p in whole.rglob("*") if p.is_file())
    noticed = 0
    for k, name in enumerate(choice.choice(files, 10, replace=False)):
        store = shutil.copytree(whole, tmp_path / f"{k}")
        place = int(choice.integers(len((store / name).read_bytes())))
        flip(store / name, int(choice.integers(8)), place)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                small_map(store)
            except ValueError as error:
                assert "store: " in str(error)  # noqa: PT017
                noticed += 1
                continue
        noticed += bool(caught)
        xarray.testing.assert_identical(xarray.open_zarr(store), xarray.open_zarr(whole))
        shutil.rmtree(store)
    assert noticed >= 9


def test_readers_meet_an_error_not_a_wrong_number(store):
    flip(chunk(store))
    with xarray.open_zarr(store) as found, pytest.raises(Exception, match=r"checksum|Zstd"):
        found[VARIABLE].load()


def test_a_store_opens_without_a_warning(store, whole):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = xarray.open_zarr(store)
        xarray.testing.assert_identical(found, xarray.open_zarr(store, consolidated=False))
        xarray.open_datatree(store, engine="zarr", consolidated=True)
    assert "vibrojax" not in {*found.variables, *found.dims}
    assert found.attrs["summary"].startswith("All 6 lanes")


def test_what_was_added_to_a_store_by_others_is_no_damage(store):
    (store / "notes.txt").write_text("mine")
    (store / "vibrojax" / "chunks" / "notes").write_text("mine")
    (store / VARIABLE / "c" / ".nfs0001").write_text("left by a file system")
    edit(store / ROOT, with_value("me", "attributes", "author"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = small_map(store)
    assert found.attrs["author"] == "me"
    assert (store / "notes.txt").exists()


def test_a_damaged_chunk_that_fails_now_is_missing_not_wrong(tmp_path):
    measure = Fragile(tmp_path / "flag")
    settings = {"measures": {"fragile": measure}, "keep_curves": False}
    small_map(tmp_path / "map", **settings)
    flip(tmp_path / "map/fragile/c/1")
    measure.flag.touch()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = small_map(tmp_path / "map", **settings)
    assert [
        ("was damaged" in str(w.message), "failed twice" in str(w.message)) for w in warned
    ] == [
        (True, False),
        (False, True),
    ]
    np.testing.assert_array_equal(found["fragile"], [1.0, 1.2, np.nan, np.nan, 1.8, 2.0])


def test_an_interrupted_repair_goes_on(store, whole, monkeypatch):
    for number in range(CHUNKS):
        flip(chunk(store, number=number))

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("vibrojax.maps.work.MapWork.compute", interrupted)
        with pytest.warns(UserWarning, match="3 of 3 chunks"), pytest.raises(KeyboardInterrupt):
            small_map(store)
    assert (xarray.open_zarr(store)["lane_status"] == 4).all()  # missing, no longer believed
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what was damaged is known
        small_map(store)
    assert_same_store(store, whole)


def test_a_store_of_an_older_format_is_refused(tmp_path):
    import zarr

    settings = json.dumps({"format": 1, "vibrojax_version": "0.1.0"})
    attributes = {"vibrojax_map": settings, "block": "[2]"}
    zarr.create_group(str(tmp_path / "old"), attributes=attributes)
    with pytest.raises(ValueError, match=r"has format 1 .vibrojax 0.1.0.*writes format 3"):
        small_map(tmp_path / "old")


def test_a_name_that_the_store_needs_is_refused(tmp_path):
    def vibrojax(curve):
        return 1.0

    with pytest.raises(ValueError, match="vibrojax is the name of a folder in every store"):
        vj.parameter_map(
            vj.default_rig, gap=[1e-4], frequency_ratio=[1.0, 1.1], measures=vibrojax,
            store=Path(tmp_path / "map"),
        )  # fmt: skip
