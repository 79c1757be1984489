"""Wrong calls are answered by vibrojax, with a sentence that names what is wrong."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from wrong_calls import CALLS

HERE = Path(__file__).parent


def answers_of(program, *arguments):
    done = subprocess.run(
        [sys.executable, HERE / program, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def answers():
    return answers_of("wrong_calls.py")


@pytest.mark.parametrize("words", CALLS)
def test_wrong_calls_are_answered_by_a_sentence(answers, words):
    kind, by_vibrojax, sentence = answers[words]
    assert kind == "ValueError"
    assert by_vibrojax, "raised elsewhere"
    assert words.lower() in sentence.lower()
    first = sentence.split()[0]
    assert first[0].isupper() or first.partition("[")[0].isidentifier() or "." in first
    assert sentence.rstrip().endswith((".", ")", "'"))


def test_junk_is_answered_by_a_sentence_that_names_the_argument():
    assert not answers_of("junk_calls.py")


@pytest.mark.slow
def test_any_junk_for_any_argument_is_answered_by_a_sentence():
    assert not answers_of("junk_calls.py", "all")
