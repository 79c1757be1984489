import shutil

import pytest

from vibrojax._tools import cache
from vibrojax.cli import command as cli

OTHERS = [f"jax-0.1.2-{k:016x}" for k in range(2)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache that is not made yet."""
    monkeypatch.setenv(cache.SWITCH, str(tmp_path / "kept"))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    return tmp_path / "kept"


@pytest.fixture
def filled(folder):
    """A cache with two traced programs, one of XLA, two other versions and a folder of the user."""
    for name, size in (("traced/one", 2**20), ("traced/two", 2**19), ("xla/a-cache", 2**21)):
        path = folder / cache.maker() / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))
    (folder / cache.maker() / "xla" / "a-atime").write_bytes(bytes(8))
    for name in (*OTHERS, "jax-md"):
        (folder / name / "traced").mkdir(parents=True)
        (folder / name / "traced" / "one").write_bytes(bytes(2**20))
    return folder


def rows(capsys):
    """What the table says, by its labels."""
    title, *lines = capsys.readouterr().out.splitlines()
    assert title == "Compiled programs, kept for the next process"
    return {line[:17].strip(): line[17:].strip() for line in lines}


def test_shows_what_is_kept(filled, capsys):
    assert cli.main(["cache"]) == 0
    assert rows(capsys) == {
        "folder": str(filled),
        "traced programs": "2, 1.5 MB",
        "XLA programs": "1, 2.0 MB",
        "other versions": "2 folders, 2.0 MB",
        "limit": "512 MB of traced programs, 512 MB of XLA programs, in each folder",
        "to clear it": "vibrojax cache --clear",
        "to move it": "VIBROJAX_CACHE=FOLDER",
        "to do without": "VIBROJAX_CACHE=0",
    }


def test_clears_its_own_folders_only(filled, capsys):
    assert cli.main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out == (
        f"Freed 5.5 MB in {filled}: 2 traced programs, 1 XLA programs, 2 folders of other "
        "versions.\n"
    )
    assert [path.name for path in filled.iterdir()] == ["jax-md"]


def test_not_made_yet(folder, capsys):
    assert cli.main(["cache"]) == 0
    shown = rows(capsys)
    assert shown["folder"] == str(folder)
    assert shown["traced programs"] == shown["XLA programs"] == "0, 0.0 MB"
    assert shown["other versions"] == "0 folders, 0.0 MB"
    assert cli.main(["cache", "--clear"]) == 0
    assert "Freed 0.0 MB" in capsys.readouterr().out
    assert not folder.exists()


@pytest.mark.parametrize("off", ["0", "off"])
@pytest.mark.parametrize("options", [[], ["--clear"]])
def test_switched_off(filled, monkeypatch, capsys, off, options):
    monkeypatch.setenv(cache.SWITCH, off)
    assert cli.main(["cache", *options]) == 0
    assert capsys.readouterr().out == f"Compiled programs are not kept: VIBROJAX_CACHE={off}.\n"
    assert (filled / OTHERS[0]).exists()


def test_a_cache_of_jax_that_the_user_has_set(filled, monkeypatch, capsys, tmp_path):
    elsewhere = tmp_path / "jax"
    elsewhere.mkdir()
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(elsewhere))
    assert cli.main(["cache"]) == 0
    said = f"1, 2.0 MB; now kept in {elsewhere} instead (JAX_COMPILATION_CACHE_DIR)"
    assert rows(capsys)["XLA programs"] == said
    assert cli.main(["cache", "--clear"]) == 0
    assert f"XLA programs in {elsewhere} (JAX_COMPILATION_CACHE_DIR)" in capsys.readouterr().out
    assert elsewhere.exists()


def test_what_cannot_be_read_or_deleted_is_one_sentence(filled, monkeypatch, capsys):
    def refuse(path, **_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(shutil, "rmtree", refuse)
    assert cli.main(["cache", "--clear"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"vibrojax: Permission denied: {filled}")
    file = filled / OTHERS[0] / "traced" / "one"
    monkeypatch.setenv(cache.SWITCH, str(file))
    assert cli.main(["cache"]) == 1
    assert capsys.readouterr() == ("", f"vibrojax: Not a directory: {file}.\n")


@pytest.mark.parametrize("wrong", [["now"], ["--all"]])
def test_wrong_options(filled, wrong):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["cache", *wrong])
    assert (filled / OTHERS[0]).exists()
