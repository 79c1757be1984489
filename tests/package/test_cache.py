"""What is kept between processes: nothing that happens to it is an error or another number."""

import os
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import jax
import pytest

from vibrojax._tools import cache

PROGRAM = """
import jax, sys
import vibrojax as vj
from vibrojax._tools import compiled
from vibrojax.model.systems import equations_of
if sys.argv[1:] == ["kept"]:
    compiled._exported = None  # fails where anything is traced
system = vj.ImpactingBeam(vj.default_rig().beam, drive=vj.BaseMotion(1e-3), num_modes=1)
for leaf in jax.tree.leaves(equations_of(system)):
    print(leaf.dtype, leaf.shape, leaf.tobytes().hex())
"""


def begun(folder, *options, **environment):
    """A process that computes, with its cache in a folder."""
    known = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *options],
        env={**known, cache.SWITCH: str(folder), **environment},
        cwd=Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process):
    """What a process has printed: numbers, warnings."""
    out, err = process.communicate()
    assert process.returncode == 0, err
    assert "float64" in out
    return out, err


def files(folder, pattern):
    return sorted(path for path in folder.glob(pattern) if path.is_file())


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A cache that two processes have begun at once, and what each of them printed."""
    folder = tmp_path_factory.mktemp("kept") / "cache"
    both = [begun(folder) for _ in range(2)]
    return folder, [ended(process) for process in both]


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """The folder of a cache of this process, not made yet; JAX's is where the tests have it."""
    monkeypatch.setenv(cache.SWITCH, str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_two_processes_at_once_agree(filled):
    folder, (first, second) = filled
    assert first == second
    assert first[1] == ""
    assert files(folder, "jax-*/traced/*")
    assert files(folder, "jax-*/xla/*-cache")
    assert cache.FOLDER.fullmatch(next(folder.iterdir()).name)


def test_another_process_traces_nothing(filled):
    folder, (first, _) = filled
    assert ended(begun(folder, "kept")) == first


def test_broken_files_are_as_good_as_none(filled):
    folder, (first, _) = filled
    traced = files(folder, "jax-*/traced/*")
    for path in (*traced, *files(folder, "jax-*/xla/*-cache")):
        path.write_bytes(path.read_bytes()[:50])
    assert ended(begun(folder)) == first
    assert all(path.stat().st_size > 50 for path in traced)


def test_a_cache_of_jax_that_the_user_has_set_is_left_alone(filled, tmp_path):
    folder, (first, _) = filled
    before = files(folder, "jax-*/xla/*")
    assert ended(begun(folder, JAX_COMPILATION_CACHE_DIR=str(tmp_path))) == first
    assert files(tmp_path, "*-cache")
    assert files(folder, "jax-*/xla/*") == before


def test_an_impossible_folder_is_one_warning(filled, tmp_path):
    (tmp_path / "file").write_text("")
    out, err = ended(begun(tmp_path / "file" / "cache"))
    assert out == filled[1][0][0]
    assert err.count("Warning") == err.count("cannot keep compiled programs") == 1
    assert "Not a directory" in err


def test_a_folder_that_cannot_be_written_to_is_a_warning(empty, monkeypatch):
    def refuse(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.warns(UserWarning, match=rf"in {re.escape(str(empty))} \(Read-only file system\)"):
        assert cache.start() is None
    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    cache.write(empty / "program", b"nothing")
    assert not (empty / "program").exists()


def test_where_it_is(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for off in ("0", "off", " No "):
        monkeypatch.setenv(cache.SWITCH, off)
        assert cache.root() is None
        assert cache.start() is None
        cache.clear()
    monkeypatch.setenv(cache.SWITCH, "here")
    assert cache.root() == tmp_path / "here"
    monkeypatch.setenv(cache.SWITCH, "~/here")
    assert cache.root() == Path.home() / "here"
    monkeypatch.setenv(cache.SWITCH, "~nobody-of-this-name/here")
    assert cache.root() == tmp_path / "~nobody-of-this-name/here"
    monkeypatch.delenv(cache.SWITCH)
    default = cache.root()
    assert default is not None
    assert default.name == "vibrojax"
    monkeypatch.setenv(cache.SWITCH, "1")
    assert cache.root() == default


def test_a_file_is_what_was_written_to_it(tmp_path):
    path = tmp_path / "program"
    assert cache.read(path) is None
    cache.write(path, b"first")
    cache.write(path, b"second")
    assert cache.read(path) == b"second"
    assert list(tmp_path.iterdir()) == [path]
    assert cache.read(tmp_path) is None  # a folder


def test_a_write_that_is_interrupted_leaves_what_was_there(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    path = tmp_path / "program"
    cache.write(path, b"first")
    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        cache.write(path, b"second")
    assert list(tmp_path.iterdir()) == [path]
    assert cache.read(path) == b"first"


def test_what_was_not_used_for_longest_goes_first(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "LARGEST", 30)
    for k, name in enumerate(("a", "b", "c")):
        cache.write(tmp_path / name, bytes(10))
        os.utime(tmp_path / name, (k, k))
    assert cache.read(tmp_path / "a") is not None  # used now
    cache.write(tmp_path / "d", bytes(10))
    assert sorted(os.listdir(tmp_path)) == ["a", "c", "d"]


def test_few_folders_of_other_versions_stay(empty):
    others = [empty / f"jax-0.1.{k}-{k:016x}" for k in range(cache.KEPT + 2)]
    for k, path in enumerate(others):
        (path / "traced").mkdir(parents=True)
        os.utime(path, (k, k))
    (empty / "jax-md").mkdir()  # of the user
    traced = cache.start()
    assert traced == empty / cache.maker() / "traced"
    assert sorted(empty.iterdir()) == sorted(
        [*others[-cache.KEPT :], empty / "jax-md", empty / cache.maker()]
    )
    later = empty / f"jax-0.2-{0:016x}"
    later.mkdir()
    cache.start()  # is not new: none is dropped
    assert later.exists()


def test_a_program_that_a_process_was_killed_in_writing_goes(empty):
    xla = empty / cache.maker() / "xla"
    xla.mkdir(parents=True)
    for name in ("whole-cache", "whole-atime", "half-cache", ".lockfile"):
        (xla / name).write_bytes(bytes(8))
    cache.start()
    assert sorted(os.listdir(xla)) == [".lockfile", "whole-atime", "whole-cache"]


def test_settings_of_jax_are_left_where_the_user_has_set_them(empty):
    before = dict(jax.config.values)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.start() is not None
    assert before["jax_compilation_cache_dir"]
    assert dict(jax.config.values) == before
