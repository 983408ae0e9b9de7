"""`baggie <verb>`: read the words, do what the verb says, print the result; the exit status says how it went."""

from __future__ import annotations

import inspect
import json
import shutil
import sys
import textwrap
import warnings
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, make_dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from baggie.cli.verbs import BAGGIE, Group, Verb
from baggie.errors import BaggieError, BaggieWarning, UsageError, WriteError, explained
from baggie.options.values import Options
from baggie.registry import Registry, named

if TYPE_CHECKING:
    from baggie.commissioning.doctor import Finding

DONE, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130
_HELP = ("-h", "--help")
_COMPLETION = "--tyro-"
"""How the options begin by which a shell asks how commands are completed."""
_CONFIG = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff)
_Json = Annotated[bool, tyro.conf.arg(help="Print the result as one JSON object.")]
_FORMAT_WARNING = warnings.formatwarning


def main(arguments: list[str] | None = None) -> int:
    """Run a verb; the exit status: 0 done, 1 it could not be done, 2 wrong usage (by tyro, too), 130 interrupted."""
    warnings.formatwarning = _format_warning
    return _run(sys.argv[1:] if arguments is None else arguments)


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """One line for what users should know; Python's own form for what developers should."""
    if issubclass(category, BaggieWarning):
        return f"warning: {' '.join(str(message).split())}\n"
    return _FORMAT_WARNING(message, category, filename, lineno, line)


def _run(words: list[str]) -> int:
    try:
        asked = read(words)
        if isinstance(asked, str):
            print(asked)
            return DONE
        carry_out(asked)
    except (BaggieError, OSError) as error:
        return _failed(error)
    except ImportError as error:
        if (missing := explained(error)) is None:
            raise
        return _failed(missing)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or "interrupted; the same command again goes on", file=sys.stderr)
        return INTERRUPTED
    return DONE


def carry_out(asked: Asked) -> None:
    """Do what a command asks for, and print the result."""
    result = named(asked.verb.does)(asked.options)
    if asked.verb.shows is not None:
        named(asked.verb.shows)(result, asked.json)


def _failed(error: Exception) -> int:
    """Say why in one line; the exit status."""
    print("error:", " ".join(str(error).split()), file=sys.stderr)
    return WRONG_USAGE if isinstance(error, UsageError) else FAILED


@dataclass(frozen=True)
class Asked:
    """A command, and what was said about it."""

    verb: Verb
    options: Any
    json: bool


def read(words: Sequence[str]) -> Asked | str:
    """What is asked; or an overview, where that is. Raises `UsageError`, or `SystemExit` as tyro does."""
    if words and words[0].startswith(_COMPLETION):
        tyro.cli(_whole(BAGGIE), prog="baggie", args=words, config=_CONFIG)
    name = "baggie"
    told: Verb | Group = BAGGIE
    while isinstance(told, Group):
        if words and words[0] in _HELP:
            return _overview(name, told)
        if not words or words[0] not in told.verbs:
            got = repr(words[0]) if words else "nothing"
            raise UsageError(
                f"expected a verb among {', '.join(told.verbs)} after {name}, got {got}; see {name} --help"
            )
        name, told, words = f"{name} {words[0]}", told.verbs[words[0]], words[1:]
    given: Any = tyro.cli(_command_line(told, _options(told, words)), prog=name, args=words, config=_CONFIG)
    return Asked(told, given.options, getattr(given, "json", False))


def _overview(name: str, group: Group) -> str:
    """What the verbs of a group are for."""
    width = min(shutil.get_terminal_size().columns, 120)
    indent = max(map(len, group.verbs)) + 4
    lines = [
        textwrap.fill(
            verb.summary, width, initial_indent=f"  {each:{indent - 2}}", subsequent_indent=" " * indent
        )
        for each, verb in group.verbs.items()
    ]
    summary = textwrap.fill(group.summary, width)
    more = f"What may be said about each: {name} VERB --help"
    return "\n".join([f"usage: {name} VERB ...", "", summary, "", *lines, "", *_examples(group), more])


def _examples(told: Verb | Group) -> list[str]:
    return [line for example in told.examples for line in (f"Example: {example}", "")]


def _options(verb: Verb, words: Sequence[str]) -> type:
    """The class of the options that these words are about."""
    if verb.choice is None:
        found: type = named(verb.options)
        return found
    registry: Registry[type[Options]] = named(verb.options)
    asked = ArgumentParser(add_help=False, allow_abbrev=False)
    asked.add_argument(f"--{verb.choice}", nargs="?", dest="name")
    name = asked.parse_known_args(list(words))[0].name or registry.names()[0]
    if name not in registry:
        raise UsageError(f"expected a {verb.choice} among {', '.join(registry.names())}, got {name!r}")
    kind = registry[name]
    known = {"--help", "--json", f"--{verb.choice}", *_flags(kind)}
    flags = (word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--"))
    for flag in (each for each in flags if each not in known):
        if others := [other for other, options in registry.all().items() if flag in _flags(options)]:
            raise UsageError(
                f"expected no {flag} with --{verb.choice} {name}: it is an option of {', '.join(others)}; leave it "
                f"out, or take --{verb.choice} {others[0]}"
            )
    return kind


def _flags(options: type[Options]) -> set[str]:
    return {"--" + each.name.rstrip("_").replace("_", "-") for each in fields(options)}  # type: ignore[arg-type]


def _command_line(verb: Verb, options: type) -> type:
    """A class of all that may be said about a verb."""
    # Said here, as tyro would look for it: first, at length, in the source that a class made on the spot has not.
    about = tyro.conf.arg(help=inspect.getdoc(options))
    parts: list[Any] = [("options", Annotated[options, about])]
    if verb.choice is not None:
        names = named(verb.options).names()
        words = f"Each has options of its own, which --{verb.choice} NAME --help tells."
        kind: Any = Annotated[Literal[tuple(names)], tyro.conf.arg(help=words)]
        parts.insert(0, (verb.choice, kind, names[0]))
    if verb.shows is not None:
        parts.append(("json", _Json, False))
    text = "\n\n".join(part for part in (verb.summary, verb.more, *_examples(verb)) if part)
    return make_dataclass("Words", parts, namespace={"__doc__": text}, kw_only=True)


def _whole(told: Verb | Group) -> type:
    """A class of all that may be said about a verb or a group, at once; where there is a choice, about all of it."""
    if isinstance(told, Verb):
        return _command_line(told, _any(named(told.options).all()) if told.choice else named(told.options))
    verbs = [Annotated[_whole(verb), tyro.conf.subcommand(name=name)] for name, verb in told.verbs.items()]
    return make_dataclass("Words", [("verb", reduce(or_, verbs))], namespace={"__doc__": told.summary})


def _any(kinds: Mapping[str, type]) -> type:
    """A class with the options of all these."""
    last = [kind for kind in kinds.values() if sum(issubclass(each, kind) for each in kinds.values()) == 1]
    return dataclass(frozen=True)(type("Any", tuple(last), {}))


def show(result: Mapping[str, Any], as_json: bool) -> None:
    """Print the result of a command; its warnings where nobody overlooks them, too."""
    for warning in result.get("warnings", ()):
        print(f"warning: {warning}", file=sys.stderr)
    print(json.dumps(result, default=str) if as_json else "\n".join(_lines(result)))


def show_recording(found: tuple[Mapping[str, Any], WriteError | None], as_json: bool) -> None:
    """Print what is in a recording. Raises what there was in the way of its contact sheet."""
    summary, trouble = found
    show(summary, as_json)
    if trouble is not None:
        raise trouble


def show_page(page: Path, as_json: bool) -> None:
    """Print where a report is."""
    show({"report": str(page)}, as_json)


def show_findings(findings: Sequence[Finding], as_json: bool) -> None:
    """Print what the doctor found. Raises `BaggieError` where a check has failed."""
    from rich.console import Console  # noqa: PLC0415

    from baggie.commissioning.doctor import as_table, require_healthy  # noqa: PLC0415 -- the doctor's verb alone

    if as_json:
        show({"findings": [asdict(finding) for finding in findings]}, as_json)
    else:
        Console().print(as_table(findings))
    require_healthy(findings)


def _lines(result: Mapping[str, Any], indent: str = "") -> list[str]:
    """A nested result as indented lines."""
    lines = []
    for key, value in result.items():
        name = str(key).replace("_", " ")
        if isinstance(value, Mapping) and any(isinstance(inner, Mapping) for inner in value.values()):
            lines += [f"{indent}{name}:", *_lines(value, indent + "  ")]
        elif isinstance(value, (list, tuple)) and len(value) > 12:
            lines.append(f"{indent}{name}: {len(value)} entries")
        else:
            lines.append(f"{indent}{name}: {_in_short(value)}")
    return lines


def _in_short(value: Any, digits: int = 3) -> str:
    """A value in short; the numbers of matrices with two more digits, the files have them all."""
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_in_short(inner, digits)}" for key, inner in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_in_short(inner, 5) for inner in value) + "]" if value else "none"
    return str(value)


if __name__ == "__main__":
    sys.exit(main())
