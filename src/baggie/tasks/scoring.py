"""How much of a task is done: as Ravens counts it, and strictly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from baggie.tasks.conditions import Condition, State

STANDS_S = 2.0


class Score:
    """The published reward, from one pick and place to the next.

    Zeng et al., "Transporter Networks", CoRL 2020. The condition at hand earns its share of its weight. As published,
    what is no longer so loses its share again, and a condition that was met once is never looked at again. At most one
    is met at a time.
    """

    def __init__(self, conditions: Sequence[Condition]) -> None:
        self.total = 0.0
        """The reward so far, 1 for all of the task: the partial credit."""
        self._conditions = tuple(conditions)
        self._met = 0

    @property
    def done(self) -> bool:
        """Whether every condition has been met."""
        return self._met == len(self._conditions)

    def count(self, state: State) -> float:
        """How much the total has grown (or shrunk) since the last time, by where everything is now."""
        if self.done:
            return 0.0
        condition, before = self._conditions[self._met], self.total
        share, earned = condition.share(state), 0.0
        if share >= 1.0:
            self._met += 1
        else:
            earned = condition.weight * share
        # Of the sum of all weights, added up alike, so that all of the task is 1 exactly.
        self.total = (_weight(self._conditions[: self._met]) + earned) / _weight(self._conditions)
        return self.total - before


class Standing(Protocol):
    """Of a workcell, what strict success asks."""

    def state(self) -> State | None:
        """Where everything is; None where nobody knows."""
        ...

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        ...


def all_hold(conditions: Sequence[Condition], state: State) -> bool:
    """Whether every condition holds, strictly."""
    return all(condition.holds(state) for condition in conditions)


def strict_success(conditions: Sequence[Condition], cell: Standing, stands_s: float = STANDS_S) -> bool:
    """Whether all conditions hold now and still do after `stands_s` seconds, which pass only if they do now.

    Never so where nobody knows where things are.
    """
    for waited_s in (0.0, stands_s):
        if waited_s:
            cell.wait(waited_s)
        state = cell.state()
        if state is None or not all_hold(conditions, state):
            return False
    return True


def _weight(conditions: Sequence[Condition]) -> float:
    return sum(condition.weight for condition in conditions)
