"""A pickle of plain data is read as it is; anything else is refused in one line, and nothing of it ever runs."""

from __future__ import annotations

import builtins
import functools
import math
import os
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.errors import DataError
from baggie.ravens.format import load_plain, plain_bytes

DTYPES = ["?", "u1", "<u2", "i4", "<i8", ">i8", "<f4", ">f4", "f8"]

numbers = st.integers() | st.floats(allow_nan=False)
scalars = st.none() | st.booleans() | numbers | st.text() | st.binary()
arrays = st.builds(
    lambda dtype, shape, order: np.array(np.arange(math.prod(shape)).reshape(shape), dtype, order=order),
    st.sampled_from(DTYPES),
    st.lists(st.integers(0, 3), max_size=3).map(tuple),
    st.sampled_from(["C", "F"]),
)
plain = st.recursive(
    scalars | arrays,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text() | st.integers(), inner, max_size=3)
    ),
    max_leaves=8,
)


def assert_same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        assert_same(list(a.values()), list(b.values()))
    elif isinstance(a, list | tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


def in_native_order(value: Any) -> Any:
    """As numpy itself may load what was stored in the other byte order."""
    if isinstance(value, np.ndarray):
        return value.astype(value.dtype.newbyteorder("="))
    if isinstance(value, dict):
        return {key: in_native_order(item) for key, item in value.items()}
    return type(value)(map(in_native_order, value)) if isinstance(value, list | tuple) else value


def refusal(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        load_plain(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert len(message) < len(str(path)) + 300
    return message


@pytest.fixture(scope="module")
def shared_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pickles") / "a.pkl"


@given(plain)
def test_what_is_written_is_read_here_and_by_pickle_itself(shared_path: Path, value: object) -> None:
    shared_path.write_bytes(plain_bytes(value))
    assert_same(load_plain(shared_path), value)
    assert_same(in_native_order(pickle.loads(shared_path.read_bytes())), in_native_order(value))


@given(plain, st.sampled_from([3, 4]))
def test_pickles_of_others_are_read(shared_path: Path, value: object, protocol: int) -> None:
    shared_path.write_bytes(pickle.dumps(value, protocol))
    assert_same(load_plain(shared_path), value)


def test_numpy_is_written_by_the_name_that_all_versions_know(shared_path: Path) -> None:
    content = plain_bytes({"a": np.arange(3), "b": [np.float64(1.5), np.arange(2.0)]})
    names = {argument for code, argument, _ in pickletools.genops(content) if code.name == "GLOBAL"}
    assert names >= {"numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"}
    shared_path.write_bytes(content)
    assert_same(load_plain(shared_path), {"a": np.arange(3), "b": [1.5, np.arange(2.0)]})
    newer = content.replace(b"numpy.core.", b"numpy._core.")
    assert newer != content
    shared_path.write_bytes(newer)
    assert_same(load_plain(shared_path), {"a": np.arange(3), "b": [1.5, np.arange(2.0)]})


def test_arrays_are_the_bytes_that_were_read(shared_path: Path) -> None:
    shared_path.write_bytes(plain_bytes(np.arange(5)))
    array = load_plain(shared_path)
    assert isinstance(array, np.ndarray)
    assert not array.flags.writeable
    assert isinstance(array.base, bytes)


class Calls:
    """Pickles as a call of a function."""

    def __init__(self, function: Callable[..., object], *arguments: object) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return self.call


ATTACKS = {
    "system": lambda canary: Calls(os.system, f"touch {canary}"),
    "eval": lambda canary: Calls(builtins.eval, f"open({str(canary)!r}, 'w')"),
    "getattr": lambda canary: Calls(builtins.getattr, Calls(os.mkdir, str(canary)), "real"),
    "tofile": lambda canary: Calls(np.save, str(canary), np.arange(3)),
    "partial": lambda canary: Calls(functools.partial(os.mkdir, str(canary))),
}


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
@pytest.mark.parametrize("wrapped", [False, True])
def test_nothing_in_a_pickle_runs(tmp_path: Path, name: str, protocol: int, wrapped: bool) -> None:
    canary = tmp_path / "canary.npy"
    attack: object = ATTACKS[name](canary)
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps([{"pose0": (1.0, attack)}] if wrapped else attack, protocol))
    message = refusal(path)
    assert not canary.exists()
    assert "the name '" in message
    try:
        pickle.loads(path.read_bytes())
    except Exception:
        assert name in ("getattr", "partial")
    assert canary.exists()  # so it was an attack


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("numpy", "load"),
        ("numpy", "fromfile"),
        ("numpy", "memmap"),
        ("numpy", "ndarray.tofile"),
        ("numpy._core.multiarray", "fromstring"),
        ("numpy.core.multiarray", "_reconstruct.__self__"),
        ("numpy.testing._private.utils", "runstring"),
        ("builtins", "exec"),
        ("copyreg", "_reconstructor"),
        ("_codecs", "encode"),
        ("os\x85\u2028", "system" * 1000),
    ],
)
def test_every_other_name_is_refused_and_shown(tmp_path: Path, module: str, name: str) -> None:
    texts = [b"\x8d" + len(text.encode()).to_bytes(8, "little") + text.encode() for text in (module, name)]
    path = tmp_path / "a.pkl"
    path.write_bytes(b"\x80\x04" + b"".join(texts) + b"\x93.")
    assert f"the name {f'{module}.{name}'[:80]!a}" in refusal(path)


class Subclass(np.ndarray[Any, Any]):
    pass


OBJECTS = {
    "objects": np.array([1, "a", None], object),
    "fields": np.zeros(2, [("a", "f8"), ("b", "O")]),
    "nested fields": np.zeros(2, [("a", [("b", [("c", "f8")])])]),
    "fields of arrays": np.zeros(2, [("a", "f8", (2, 2))]),
    "text": np.array(["a"]),
    "dates": np.array(["2020-01-01"], "M8[D]"),
    "complex": np.array([1j]),
    "bare dtype": np.dtype("f8"),
    "subclass": np.arange(3).view(Subclass),
    "set": {1, 2},
    "bytearray": bytearray(b"a"),
    "complex number": 1j,
    "tuple keys": {(1, 2): 3},
    "nan keys": {1.5: 3},
}


@pytest.mark.parametrize("name", OBJECTS)
def test_what_is_not_plain_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(OBJECTS[name], 4))
    assert "only arrays, numbers, strings, tuples, lists and dicts are expected" in refusal(path)


ARRAY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR"
MINUS_ONE = b"J\xff\xff\xff\xff"
F8_SINGLETON = b"cnumpy\ndtype\n(X\x02\x00\x00\x00f8\x89\x89tR"
F8 = F8_SINGLETON + b"(K\x03X\x01\x00\x00\x00<NNN" + 2 * MINUS_ONE + b"K\x00tb"
EIGHT = b"C\x08" + bytes(8)
CRAFTED = {
    "dtype of ndarray": b"cnumpy\ndtype\n(cnumpy\nndarray\ntR.",
    "dtype of an endless list": b"cnumpy\ndtype\n(]q\x00h\x00atR.",
    "dtype made of objects": b"cnumpy\ndtype\n(X\x01\x00\x00\x00OtR.",
    "state of a singleton": F8_SINGLETON + b"(K\x03X\x01\x00\x00\x00>NN}K\x10K\x01K\x7ftb.",
    "pointer from bytes": b"cnumpy\nndarray\n((K\x01tX\x01\x00\x00\x00O" + EIGHT + b"tR.",
    "ndarray called": b"cnumpy\nndarray\n((J\xff\xff\xff\x7ftX\x02\x00\x00\x00f8tR.",
    "attribute of a name": b"cnumpy\ndtype\nN}X\x05\x00\x00\x00_makeNs\x86b.",
    "another class": b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\ndtype\n(K\x00tC\x01btR.",
    "array without state": ARRAY + b".",
    "too few bytes": ARRAY + b"(K\x01(K\x02t" + F8 + b"\x89" + EIGHT + b"tb.",
    "too many bytes": ARRAY + b"(K\x01(t" + F8 + b"\x89C\x09" + bytes(9) + b"tb.",
    "negative shape": ARRAY + b"(K\x01(" + 2 * MINUS_ONE + b"t" + F8 + b"\x89" + EIGHT + b"tb.",
    "objects in a list": ARRAY + b"(K\x01(K\x01t" + F8 + b"\x89]Natb.",
    "scalar of a list": b"cnumpy.core.multiarray\nscalar\n(" + F8 + b"]tR.",
    "short scalar": b"cnumpy.core.multiarray\nscalar\n(" + F8 + b"C\x01atR.",
    "a list in itself": b"\x80\x02]q\x00h\x00a.",
    "nested deeply": b"\x80\x02" + b"]" * 5000 + b"a" * 4999 + b".",
}


def test_the_crafted_array_is_one_but_for_its_flaws(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(ARRAY + b"(K\x01(K\x01t" + F8 + b"\x89" + EIGHT + b"tb.")
    assert_same(load_plain(path), np.zeros(1))


@pytest.mark.parametrize("name", CRAFTED)
def test_crafted_pickles_change_nothing(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(CRAFTED[name])
    refusal(path)
    assert np.dtype("f8").isnative
    assert np.dtype("f8").fields is None
    path.write_bytes(plain_bytes(np.arange(2.0)))
    assert_same(load_plain(path), np.arange(2.0))


def test_parts_shared_again_and_again_are_read_once(tmp_path: Path) -> None:
    value: object = 1.0
    for _ in range(14):
        value = [value] * 50
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(value))
    read = load_plain(path)  # which would never end if each of the 50¹⁴ parts were read
    for _ in range(14):
        assert isinstance(read, list)
        assert len(read) == 50
        read = read[-1]
    assert read == 1.0


def test_a_file_cut_off_anywhere_is_named(tmp_path: Path) -> None:
    content = plain_bytes([{"pose0": (np.arange(3.0), np.arange(4))}, None])
    path = tmp_path / "a.pkl"
    for length in range(len(content)):
        path.write_bytes(content[:length])
        assert "cut off or damaged" in refusal(path)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"hello\n",
        bytes(100),
        b"\x80\x63.",
        b"\x93NUMPY\x01\x00v\x00",
        b"\x89PNG\r\n\x1a\n",
        b"I1\nPx\n.",
    ],
)
def test_garbage_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(content)
    refusal(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "a.pkl")
