"""People's files: what is written is what is read, whoever reads it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from baggie.calibration.files import VIEWS_FILE, read_calibration, read_views_file
from baggie.calibration.intrinsics.camera_calibration import read_factory
from baggie.errors import BaggieError, DataError, WriteError
from baggie.files import parse_yaml, read_json, read_yaml, written_whole
from baggie.policies.baselines import ColorMaskPolicy
from baggie.policies.checkpoint import read_config
from baggie.workcell.workcell_file import read_workcell_file

CONTENT = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@given(CONTENT)
def test_what_is_written_by_us_is_read_as_it_was(content: Any) -> None:
    assert parse_yaml(yaml.safe_dump(content), "it") == content


@given(st.integers(), st.from_regex(r"[0-9]([0-9:_.eEx-]{0,12}[0-9eE_.])?", fullmatch=True))
def test_a_number_is_a_number_only_where_it_reads_like_one(whole: int, written: str) -> None:
    assert parse_yaml(str(whole), "it") == whole
    read = parse_yaml(written, "it")
    if isinstance(read, int):
        assert str(read) == written
    elif isinstance(read, float):
        assert read == float(written) or math.isnan(read)
        assert "_" not in written
    else:
        assert read == written


def test_merging_is_no_key_given_twice() -> None:
    text = "a: &a {x: 1, y: 2}\nb:\n  <<: *a\n  x: 3\n"
    assert parse_yaml(text, "it")["b"] == {"x": 3, "y": 2}


READERS: list[Callable[[Path], Any]] = [
    read_workcell_file,
    lambda path: read_calibration(path, "intrinsics"),
    lambda path: read_config(path.parent),
    lambda path: ColorMaskPolicy.load(path.parent),
    read_factory,
    read_yaml,
    read_json,
    lambda path: read_views_file(path.parent),
]


@pytest.mark.parametrize("read", READERS, ids=range(len(READERS)))
@pytest.mark.parametrize(
    "content",
    [
        "Küche: 1".encode("latin-1"),
        bytes(range(256)),
        b"policy: a\npolicy: b\n",
        b'{"a": 1, "a": 2}',
        b"[" * 5000,
        b"1" * 5000,
        b"a: \x00",
        b"{[1]: 2}",
        b"--- 1\n--- 2\n",
        b"",
    ],
    ids=lambda content: content[:12],
)
def test_whatever_a_file_holds_is_one_line(
    tmp_path: Path, read: Callable[[Path], Any], content: bytes
) -> None:
    for name in ("config.yaml", VIEWS_FILE):
        (tmp_path / name).write_bytes(content)
    if read is read_yaml and content in {b"", b"1" * 5000}:
        return
    with pytest.raises(BaggieError) as error:
        read(tmp_path / "config.yaml")
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_views_with_a_key_twice_are_refused(tmp_path: Path) -> None:
    (tmp_path / VIEWS_FILE).write_text('{"views": [], "units": "m", "units": "mm"}')
    with pytest.raises(DataError, match="the key 'units' stands there twice; write it again"):
        read_views_file(tmp_path)
    (tmp_path / VIEWS_FILE).write_text('{"views": []}', "utf-8-sig")
    assert read_views_file(tmp_path) == {"views": []}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_what_is_not_written_to_its_end_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "folder" / "film.mp4"

    def write(text: str, then: BaseException | None = None) -> None:
        with written_whole(path) as partial:
            partial.write_text(text)
            if then:
                raise then

    write("before")
    with pytest.raises((KeyboardInterrupt, WriteError)):
        write("half", error)
    assert [each.name for each in path.parent.iterdir()] == ["film.mp4"]
    assert path.read_text() == "before"
