"""Work in other processes: every result, every question and every error comes back.

What the workers do is defined here, in a file that imports little: each imports it again.
"""

import functools

import pytest

from baggie.errors import BaggieError
from baggie.processes import ask_parent, stream_in_processes


def times(factor: int):
    """A worker that refuses 13."""

    def run(task: int):
        for step in range(3):
            if task == 13:
                raise BaggieError("13 brings bad luck")
            if task == 14:
                raise ZeroDivisionError("14 is worse")
            yield factor * task + step

    return run


def test_processes_stream_every_result():
    results = stream_in_processes(functools.partial(times, 10), range(7), workers=2)
    assert sorted(results) == sorted(10 * task + step for task in range(7) for step in range(3))


def asking():
    """A worker that asks before it answers."""

    def run(task: int):
        yield task, ask_parent(f"may I do {task}?")

    return run


def test_a_worker_is_answered_by_the_process_that_started_it():
    answers = stream_in_processes(asking, range(5), workers=2, answer=lambda question: "3" in question)
    assert dict(answers) == {task: task == 3 for task in range(5)}
    assert not ask_parent("and here?")


def test_errors_in_processes_come_back_as_they_are():
    with pytest.raises(BaggieError, match="bad luck"):
        list(stream_in_processes(functools.partial(times, 1), [1, 13], workers=1))
    with pytest.raises(RuntimeError, match="14 is worse"):
        list(stream_in_processes(functools.partial(times, 1), [14], workers=1))
