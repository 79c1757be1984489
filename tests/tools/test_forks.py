"""Processes that are forked from one that has computed: a sentence in the place of a hang."""

import json
import subprocess
import sys

import pytest

PROGRAM = """
import json, multiprocessing, warnings
import numpy as np

def modes():
    return vj.modes(vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0), 2).frequency[0]

def other_modes():
    return vj.modes(vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0), 3).frequency[0]

def sweep():
    return vj.frequency_sweep(vj.default_rig(), frequency_ratio=[1.0]).amplitude[0, 0]

def matrices():
    one = [[1.0]]
    system = vj.MatrixSystem(one, one, one, drive=vj.BaseMotion(1e-3), stops=(), stop_map=None,
                             input_map=[1.0], response_map=[1.0])
    return system.equations().angular_frequency[0]

def numpy():
    return vj.default_rig().stops[0].gap

def answer(queue, call):
    try:
        queue.put(float(call()))
    except Exception as error:
        queue.put(f"{type(error).__name__}: {error}")

def asked(start, call):
    context = multiprocessing.get_context(start)
    queue = context.Queue()
    process = context.Process(target=answer, args=(queue, call))
    process.start()
    found = queue.get(timeout=100)
    process.join(100)
    return found

import vibrojax as vj

if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of JAX, at every fork
    answers = {"before": asked("fork", modes)}
    own = float(modes())
    for call in (modes, other_modes, sweep, matrices, numpy):
        answers[call.__name__] = asked("fork", call)
    answers["spawned"] = asked("spawn", modes)
    print(json.dumps([own, answers]))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_a_forked_process_answers_by_a_sentence(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    ended = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, timeout=240, check=False
    )
    assert ended.returncode == 0, ended.stderr
    own, answers = json.loads(ended.stdout)
    # A process that has not computed may be forked, and one that is spawned starts anew.
    assert answers["before"] == answers["spawned"] == own
    for call in ("modes", "other_modes", "sweep", "matrices"):
        assert answers[call].startswith("RuntimeError: JAX cannot compute in a process that was")
        assert 'get_context("spawn")' in answers[call]
    assert answers["numpy"] == 0.4e-3
