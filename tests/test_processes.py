"""Work in other processes: every result, every question and every error comes back.

What the workers do is defined here, in a file that imports little: each imports it again.
"""

import functools

import pytest

from baggie.errors import BaggieError, NobodyError
from baggie.operator import Caution, Nobody, Operator, choice, errand
from baggie.processes import Executor, LocalProcesses
from helpers.scripted import Scripted
from helpers.streaming import Here

executors = pytest.mark.parametrize(
    "executor", [LocalProcesses(), Here()], ids=lambda each: type(each).__name__
)


def times(factor: int, _operator: Operator):
    """A worker that refuses 13."""

    def run(task: int):
        for step in range(3):
            if task == 13:
                raise BaggieError("13 brings bad luck")
            if task == 14:
                raise ZeroDivisionError("14 is worse")
            yield factor * task + step

    return run


@executors
def test_every_result_of_every_task_comes_back(executor: Executor):
    results = executor.stream(functools.partial(times, 10), range(7), 2, Nobody())
    assert sorted(results) == sorted(10 * task + step for task in range(7) for step in range(3))


def asking(operator: Operator):
    """A worker that tells, and asks before it answers."""

    def run(task: int):
        operator.tell(Caution(f"{task} comes"))
        try:
            yield task, operator.attended, operator.ask(choice(f"how is {task}?", "fine", ("fine", "odd")))
            operator.ask(errand(f"lay {task} aside"))
        except NobodyError as error:
            yield task, operator.attended, str(error)

    return run


@executors
def test_a_worker_tells_and_asks_whoever_watches_over_the_one_that_started_it(executor: Executor):
    person = Scripted("odd", "", "neither", "", "")
    results = executor.stream(asking, [3, 4], 1, person)
    assert list(results) == [(3, True, "odd"), (4, True, "fine")]
    assert person.told == [Caution("3 comes"), Caution("4 comes")]
    again = "'neither' will not do (expected fine or odd); how is 4?"
    assert person.asked == ["how is 3?", "lay 3 aside", "how is 4?", again, "lay 4 aside"]


@executors
def test_where_nobody_watches_a_worker_hears_that_nobody_answers(executor: Executor):
    results = {
        task: (attended, said) for task, attended, said in executor.stream(asking, range(3), 2, Nobody())
    }
    assert results == {
        task: (False, f"nobody answers: how is {task}?; run this in a terminal") for task in range(3)
    }


def test_errors_in_processes_come_back_as_they_are():
    with pytest.raises(BaggieError, match="bad luck"):
        list(LocalProcesses().stream(functools.partial(times, 1), [1, 13], 1, Nobody()))
    with pytest.raises(RuntimeError, match="14 is worse"):
        list(LocalProcesses().stream(functools.partial(times, 1), [14], 1, Nobody()))
