"""Numbers on the command line: whatever is out of range is refused before anything runs, with exit status 2."""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import pytest
from annotated_types import Interval

from baggie.cli import main as cli
from baggie.cli.verbs import BAGGIE, Group, Verb
from baggie.commissioning.image_to_robot import parse_marker
from baggie.errors import BaggieError, UsageError
from baggie.options.commissioning import LabOptions
from baggie.options.values import Count, Options, Point, Share, hints
from baggie.registry import named
from baggie.vision.targets import parse_target


@dataclass(frozen=True)
class Option:
    """One number of a command's options."""

    words: tuple[str, ...]
    """The command."""
    made_by: type[Options]
    name: str
    hint: Any

    @property
    def flag(self) -> str:
        """As it is written on the command line."""
        return "--" + self.name.rstrip("_").replace("_", "-")


def commands(
    told: Verb | Group = BAGGIE, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], type]]:
    """Every command there is with its options, `calibrate check` and the like included."""
    if isinstance(told, Group):
        for name, verb in told.verbs.items():
            yield from commands(verb, (*words, name))
    elif told.choice is None:
        yield words, named(told.options)
    else:
        for name, options in named(told.options).all().items():
            yield (*words, f"--{told.choice}", name), options


def numeric(hint: Any) -> bool:
    """Whether a value of this type is a number, or has numbers in it."""
    inner = [each for each in get_args(hint) if get_origin(hint) is not None]
    origin = get_origin(hint)
    if origin is Annotated:
        return numeric(inner[0])
    if origin in {tuple, Union, types.UnionType}:
        return any(numeric(each) for each in inner)
    return hint in {int, float}


def all_options() -> list[Option]:
    """Every number that any command can be given."""
    found = []
    for words, options in commands():
        assert issubclass(options, Options) or not any(map(numeric, get_type_hints(options).values())), (
            options
        )
        known = hints(options) if issubclass(options, Options) else {}
        found += [Option(words, options, name, its) for name, its in known.items() if numeric(its)]
    return found


OPTIONS = all_options()


def leaves(hint: Any) -> Iterator[Any]:
    """The types of single numbers in it."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated and numeric(inner[0]) and get_origin(inner[0]) is None:
        yield hint
    elif origin is not None:
        for each in inner:
            yield from leaves(each)
    elif hint in {int, float}:
        yield hint


def wrong(hint: Any) -> list[float]:
    """Numbers just outside, far outside, and none at all."""
    (interval,) = hint.__metadata__
    assert isinstance(interval, Interval)
    step = 1 if hint.__origin__ is int else 1e-6
    bounds = [interval.ge, interval.gt, interval.le]
    outside = [interval.ge - step] if interval.ge is not None else []
    outside += [interval.gt, interval.gt - step] if interval.gt is not None else []
    outside += [interval.le + step] if interval.le is not None else []
    assert outside, bounds
    return [*outside, -(10**30)] if hint.__origin__ is int else [*outside, math.nan, math.inf, -math.inf]


def in_place(hint: Any, leaf: Any, number: float) -> Any:
    """A value of this type with the number in it, as it is for a tuple's last part."""
    if get_origin(hint) in {Union, types.UnionType}:
        return in_place(next(each for each in get_args(hint) if numeric(each)), leaf, number)
    if get_origin(hint) is tuple:
        inner = [each for each in get_args(hint) if each is not ...]
        return (*([1] * (len(inner) - 1)), number)
    return number


def test_there_are_numbers_to_try() -> None:
    tried = {(*option.words, option.flag) for option in OPTIONS}
    assert {
        ("train", "--policy", "keypoint", "--steps"),
        ("lab", "--camera-port"),
        ("evaluate", "--radius-cm"),
        ("calibrate", "check", "--points"),
        ("inspect", "--columns"),
        ("print-target", "--color"),
    } <= tried


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: " ".join((*option.words, option.flag)))
def test_every_number_has_an_interval_which_is_kept(option: Option) -> None:
    needed = {each.name: "x" for each in fields(option.made_by) if each.default is MISSING}
    made = option.made_by(**needed)  # the defaults are inside
    assert made
    for leaf in leaves(option.hint):
        assert get_origin(leaf) is Annotated, f"{option.flag} has no interval"
        for number in wrong(leaf):
            given = in_place(option.hint, leaf, number)
            with pytest.raises(UsageError, match=f"expected {option.flag} to be a number .*, got") as error:
                option.made_by(**needed, **{option.name: given})
            assert "\n" not in str(error.value)


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: " ".join((*option.words, option.flag)))
def test_the_command_says_so_in_one_line_and_ends_with_2(
    option: Option, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *_ = leaves(option.hint)
    given = in_place(option.hint, first, wrong(first)[0])
    numbers = map(str, given if isinstance(given, tuple) else [given])
    flags = [
        each.name
        for each in fields(option.made_by)
        if each.default is MISSING and each.name not in ("data", "folder")
    ]
    needed = ["x"] * (option.words[0] in {"inspect", "import-ravens"})
    needed += ["--data", "x"] * (option.words[0] in {"train", "validate"})
    needed += [word for name in flags for word in (f"--{name}", "x")]
    assert cli.main([*option.words, *needed, option.flag, *numbers]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith(f"error: expected {option.flag} to be a number ")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("train --steps 0", "expected --steps to be a number from 1 to 10000000, got 0"),
        ("train --seed -1", "expected --seed to be a number from 0 to 9223372036854775807, got -1"),
        ("evaluate --policy x --radius-cm nan", "expected --radius-cm to be a number above 0, got nan"),
        ("import-ravens x --x 1 0", "expected bounds of x from low to high, metres, got 1.0 to 0.0"),
        ("train --policy regression --new-looks 0.5", "expected no --new-looks with --policy regression"),
    ],
)
def test_what_is_said(words: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = ["--data", "x"] * words.startswith("train")
    assert cli.main([*words.split(), *data, "--out", str(tmp_path / "out")]) == 2
    assert line in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (parse_target, "charuco:100000x5:0.03:0.02:DICT_4X4_50"),
        (parse_target, f"chessboard:{'9' * 20}x6:0.02"),
        (parse_target, "chessboard:9x6:nan"),
        (parse_target, "aruco:DICT_4X4_50:3:inf"),
        (parse_marker, "color:300,0,0"),
        (parse_marker, "color:-1,0,0"),
        *(
            (lambda words: LabOptions(fault=(words,)).faults(), f"reflex:{after}")
            for after in ("nan", "inf", "-1", "x")
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_numbers_in_words_are_refused_too(read: Callable[[str], object], words: str) -> None:
    with pytest.raises(BaggieError, match="expected") as error:
        read(words)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@dataclass(frozen=True)
class Asked(Options):
    """Some of every kind."""

    many: Count = 1
    part: Share | None = None
    place: Point = (0.0, 0.0, 0.0)


def test_numbers_inside_are_kept_as_they_are() -> None:
    asked = Asked(10**7, 1.0, (-10.0, 0.0, 10.0))
    assert (asked.many, asked.part, asked.place) == (10**7, 1.0, (-10.0, 0.0, 10.0))
    for wrong_one in ({"part": 1.1}, {"place": (0.0, 0.0, math.nan)}, {"many": 0}):
        with pytest.raises(UsageError):
            Asked(**wrong_one)  # type: ignore[arg-type]
