"""The words of a command line: which command they are for, and what they say about it."""

from __future__ import annotations

import shutil
import textwrap
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, make_dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

import tyro

from baggie.cli.verbs import BAGGIE, Group, Verb
from baggie.errors import UsageError
from baggie.options.ranges import Options
from baggie.registry import Registry, named

_HELP = ("-h", "--help")
_COMPLETION = "--tyro-"
"""How the options begin by which a shell asks how commands are completed."""
_CONFIG = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff)
_Json = Annotated[bool, tyro.conf.arg(help="Print the result as one JSON object.")]


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
    given: Any = tyro.cli(_words(told, _options(told, words)), prog=name, args=words, config=_CONFIG)
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


def _words(verb: Verb, options: type) -> type:
    """A class of all that may be said about a verb."""
    parts: list[Any] = [("options", options)]
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
        return _words(told, _any(named(told.options).all()) if told.choice else named(told.options))
    verbs = [Annotated[_whole(verb), tyro.conf.subcommand(name=name)] for name, verb in told.verbs.items()]
    return make_dataclass("Words", [("verb", reduce(or_, verbs))], namespace={"__doc__": told.summary})


def _any(kinds: Mapping[str, type]) -> type:
    """A class with the options of all these."""
    last = [kind for kind in kinds.values() if sum(issubclass(each, kind) for each in kinds.values()) == 1]
    return dataclass(frozen=True)(type("Any", tuple(last), {}))
