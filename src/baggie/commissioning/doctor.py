"""`baggie doctor`: checks all that can be checked of a workcell, first without moving, then, with leave, slowly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.markup import escape
from rich.table import Table

from baggie.commissioning.health import HELPED, MOVING, STILL, Check, Doubt, HelpedCheck, NotTriedError
from baggie.commissioning.session import Helper, Person
from baggie.errors import BaggieError, NobodyError
from baggie.operator import Operator, Question, TerminalOperator
from baggie.options.commissioning import DoctorOptions
from baggie.workcell.config import open_workcell
from baggie.workcell.workcell import Workcell

Verdict = Literal["ok", "look", "failed", "not tried"]
_COLORS: dict[Verdict, str] = {"ok": "green", "look": "yellow", "failed": "bold red", "not tried": "dim"}


@dataclass(frozen=True)
class Finding:
    """What came of one check."""

    check: str
    verdict: Verdict
    found: str


def examine(
    options: DoctorOptions, *, operator: Operator | None = None, helper: Helper | None = None
) -> list[Finding]:
    """What came of all checks, failed ones too.

    A person is asked whether the arm may move, and to lay and hold what a check needs: the one at the terminal unless
    `operator` is given. A `helper` lays and holds things instead, as simulated workcells and labs do by themselves.
    """
    try:
        cell = open_workcell(options.workcell, options.cell)
    except BaggieError as error:
        return [Finding("workcell", "failed", str(error))]
    try:
        opened = Finding("workcell", "ok", f"{options.workcell}: {cell.settings.name}")
        operator = operator or TerminalOperator()
        helper = helper or _helper(cell, options, operator)
        return [opened, *_all_checks(cell, options, operator, helper)]
    finally:
        cell.close()


def as_table(findings: Iterable[Finding]) -> Table:
    """The findings for people."""
    table = Table("check", "", "found")
    for finding in findings:
        color = _COLORS[finding.verdict]
        table.add_row(finding.check, f"[{color}]{finding.verdict}[/]", escape(finding.found))
    return table


def require_healthy(findings: Sequence[Finding]) -> None:
    """Raise `BaggieError` where a check has failed."""
    failed = [finding for finding in findings if finding.verdict == "failed"]
    if failed:
        raise BaggieError(
            f"{len(failed)} of {len(findings)} checks failed: {failed[0].check}: {failed[0].found}"
        )


def _helper(cell: Workcell, options: DoctorOptions, operator: Operator) -> Helper | None:
    """Who lays and holds things; None where nobody does."""
    from baggie.commissioning.simulated_assistant import LabAssistant, SimulatedAssistant  # noqa: PLC0415 -- all of these import the simulator
    from baggie.lab.web import LabControl  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    if options.lab is not None:
        return LabAssistant(LabControl(options.lab))
    if isinstance(cell, SimulatedWorkcell):
        return SimulatedAssistant(cell, 0)
    return Person(operator) if options.move == "ask" and operator.attended else None


def _all_checks(
    cell: Workcell, options: DoctorOptions, operator: Operator, helper: Helper | None
) -> Iterable[Finding]:
    still = list(_checked(cell, STILL))
    yield from still
    healthy = all(finding.verdict != "failed" for finding in still)
    if healthy and (options.move == "yes" or (options.move == "ask" and _may_move(cell, operator))):
        yield from _checked(cell, {**MOVING, **_with_help(helper)}, stop_at_failure=True)
        return
    why = "no leave to move" if healthy else "nothing moves before the rest is mended"
    yield from (Finding(name, "not tried", why) for name in (*MOVING, *HELPED))


def _with_help(helper: Helper | None) -> dict[str, Check]:
    """The checks that need somebody, for who there is."""

    def nobody(_cell: Workcell) -> str:
        raise NotTriedError("nobody is asked for what it needs; run it at a terminal, without --move yes")

    def helped(check: HelpedCheck, helper: Helper) -> Check:
        return lambda cell: check(cell, helper)

    return {name: helped(check, helper) if helper else nobody for name, check in HELPED.items()}


def _checked(cell: Workcell, checks: Mapping[str, Check], stop_at_failure: bool = False) -> Iterable[Finding]:
    failed = ""
    for name, check in checks.items():
        if failed:
            yield Finding(name, "not tried", f"after {failed} has failed")
            continue
        try:
            yield Finding(name, "ok", check(cell))
        except NotTriedError as reason:
            yield Finding(name, "not tried", str(reason))
        except Doubt as doubt:
            yield Finding(name, "look", str(doubt))
        except BaggieError as error:
            failed = name if stop_at_failure else ""
            yield Finding(name, "failed", str(error))


def _may_move(cell: Workcell, operator: Operator) -> bool:
    """Whether somebody gives leave; where nobody is, no."""
    words = f"may {cell.arm.info.name} move now, slowly, all over its workspace? Clear the table first"
    leave = Question(
        words, "", lambda typed: typed.lower() in {"y", "yes"}, choices=("y", "n"), keys=" [y/N]"
    )
    try:
        return operator.attended and operator.ask(leave)
    except NobodyError:
        return False
