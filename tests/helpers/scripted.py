"""A person who answers by a script."""

from __future__ import annotations

from collections.abc import Callable

from baggie.errors import NobodyError
from baggie.operator import Answer, Event, Question


class Scripted:
    """Gives these answers, one after the other, and then leaves; keeps what was told and asked."""

    def __init__(
        self, *answers: str, attended: bool = True, meanwhile: Callable[[str], object] | None = None
    ) -> None:
        """`meanwhile` is called with each question before it is answered."""
        self.attended = attended
        self.told: list[Event] = []
        self.asked: list[str] = []
        self._answers, self._meanwhile = iter(answers), meanwhile

    def tell(self, event: Event) -> None:
        """Keep it."""
        self.told.append(event)

    def ask(self, question: Question[Answer]) -> Answer:
        """As the script says, until it will do."""
        return question.answered(self._read)

    def _read(self, text: str) -> str:
        self.asked.append(text)
        if self._meanwhile is not None:
            self._meanwhile(text)
        try:
            return next(self._answers)
        except StopIteration:
            raise NobodyError(f"nobody answers: {text}") from None
