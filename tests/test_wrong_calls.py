"""Wrong calls are answered by vibrojax, with a sentence that names what is wrong."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from wrong_calls import CALLS

PROGRAM = Path(__file__).with_name("wrong_calls.py")


@pytest.fixture(scope="module")
def answers():
    done = subprocess.run(
        [sys.executable, PROGRAM], capture_output=True, text=True, check=True, timeout=300
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("words", CALLS)
def test_wrong_calls_are_answered_by_a_sentence(answers, words):
    kind, by_vibrojax, sentence = answers[words]
    assert kind == "ValueError"
    assert by_vibrojax, "raised elsewhere"
    assert words.lower() in sentence.lower()
    assert sentence[0].isupper() or sentence.split()[0].isidentifier() or "." in sentence.split()[0]
    assert sentence.rstrip().endswith((".", ")", "'"))
