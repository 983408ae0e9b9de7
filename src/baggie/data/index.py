"""The numbers of all attempts at once.

They lie in as many small files as there are attempts, each slow to open. `attempts/index.parquet` gathers
them. It is a cache: records never change, so a row of it is right as long as its record exists, and what it
lacks is read from the records themselves. Only writers write it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from baggie.data.files import check_complete, read_parquet, write_all
from baggie.data.layout import Layout, attempt_id_of
from baggie.data.record import NUMBERS, SCHEMA, complete
from baggie.errors import DataError


def read_numbers(layout: Layout, columns: Sequence[str] = NUMBERS) -> pa.Table:
    """Columns of all records, a row each, in LeRobot's order: by episode, then by step.

    Raises DataError naming a damaged record.
    """
    records = {attempt_id_of(path): path for path in layout.attempts()}
    check_complete(records.values())
    indexed = _read_index(layout, columns)
    indexed = indexed.filter(pc.is_in(indexed["attempt_id"], pa.array(records, pa.int64())))
    known = set(indexed["attempt_id"].to_pylist())
    fresh = [
        complete(read_parquet(path, columns), columns, path)
        for attempt_id, path in records.items()
        if attempt_id not in known
    ]
    return pa.concat_tables([indexed, *fresh]).sort_by(
        [("episode_index", "ascending"), ("step", "ascending")]
    )


def first_gap(numbers: pa.Table, episodes: int) -> int | None:
    """The first episode of which these rows, in LeRobot's order, lack one; None where `episodes` are whole.

    An episode's last rows are not missed: what counts them is `info.json`.
    """
    episode, step = -1, -1
    for row in zip(numbers["episode_index"].to_pylist(), numbers["step"].to_pylist(), strict=True):
        if row not in ((episode, step + 1), (episode + 1, 0)):
            return min(int(row[0]), episode + 1)
        episode, step = row
    return None if episode == episodes - 1 else episode + 1


def write_index(layout: Layout) -> None:
    """Gather the numbers of all records; nothing is lost where that fails, so it does so silently."""
    sink = pa.BufferOutputStream()
    pq.write_table(read_numbers(layout), sink, compression="zstd")
    with contextlib.suppress(OSError):
        write_all([(layout.index, sink.getvalue())], layout.partial)


def _read_index(layout: Layout, columns: Sequence[str]) -> pa.Table:
    schema = pa.schema([SCHEMA.field(name) for name in columns])
    if layout.index.exists():
        with contextlib.suppress(DataError, pa.ArrowException, ValueError):
            return complete(read_parquet(layout.index, columns), columns, layout.index).cast(schema)
    return schema.empty_table()
