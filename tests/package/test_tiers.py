"""The tiers of tests name tests that there are."""

import re
from pathlib import Path

import pytest
from tiers import DEAREST, LONG, QUICK, SLOW

FILES = {path.stem: path for path in Path(__file__).parents[1].rglob("test_*.py")}


@pytest.mark.parametrize("file", sorted({*QUICK, *SLOW, *LONG, *DEAREST}))
def test_every_test_that_is_named_is_there(file):
    text = FILES[file].read_text()
    for name in (*SLOW.get(file, ()), *LONG.get(file, ())):
        assert re.search(rf"^def {re.escape(name.partition('[')[0])}\(", text, re.M), name
    assert not set(SLOW.get(file, ())) & set(LONG.get(file, ()))  # who is long is slow
