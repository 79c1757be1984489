"""Records of the chunks of a store: what every file of a chunk was when it was written.

A chunk is whole where there is a record that agrees with all of its files, the numbers of its rigs
included; so it matters neither which file was lost nor how.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

from vibrojax.maps.store_files import file_digest, make_room, remove, write_file
from vibrojax.maps.work import MapSpec

OWN = "vibrojax"
"""The folder of what is not data: records, a copy of the attributes, the lock."""


class Condition(NamedTuple):
    """What was found of a chunk."""

    number: int
    rigs: str | None
    """Stands for the numbers of the rigs it was computed with; None where that is not known."""
    damage: tuple[str, ...] = ()
    """What is not as it was written."""

    @property
    def is_whole(self) -> bool:
        """Whether all of it is there."""
        return self.rigs is not None and not self.damage


class Records:
    """The records of a store."""

    def __init__(self, place: Path, spec: MapSpec):
        self.place, self.chunks, self.identity = place, spec.chunks, spec.identity
        self.variables = spec.template.variables

    def _file(self, number: int) -> Path:
        return self.place / OWN / "chunks" / f"{number}.json"

    def _files(self, number: int) -> dict[str, Path]:
        """The file of a chunk for each variable."""
        block = self.chunks.at(number)
        lengths = zip(block.region, self.chunks.block, strict=True)
        outer = [str(part.start // length) for part, length in lengths]
        files = {}
        for name, one in self.variables.items():
            inner = ["0"] * (len(one.shape) - len(outer))
            files[name] = self.place.joinpath(name, "c", *outer, *inner)
        return files

    def write(self, number: int, rigs: str) -> None:
        """Write down what a chunk is now."""
        made = {"chunk": number, "settings": self.identity, "rigs": rigs}
        files = {name: file_digest(file) for name, file in self._files(number).items()}
        write_file(self._file(number), json.dumps(made | {"files": files}).encode())

    def condition(self, number: int) -> Condition:
        """Find out whether a chunk is what it was."""
        file = self._file(number)
        try:
            made: Any = json.loads(file.read_bytes())
            rigs, digests = made["rigs"], dict(made["files"])
            known = made["chunk"] == number and made["settings"] == self.identity
        except FileNotFoundError:
            return Condition(number, None)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return Condition(number, None, ("its record",))
        if not known or not isinstance(rigs, str):
            return Condition(number, None, ("its record, which is of another chunk",))
        wrong = []
        for name, one in self._files(number).items():
            found = file_digest(one)
            if name not in digests or found != digests[name]:
                wrong.append(f"{name} ({'missing' if found is None else 'changed'})")
        return Condition(number, rigs, tuple(wrong))

    def clear(self, number: int) -> None:
        """Remove all of a chunk: its lanes are missing then, not wrong."""
        remove(self._file(number))
        for file in self._files(number).values():
            make_room(file, self.place)
