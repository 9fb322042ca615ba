"""A table of many results in Parquet, whose figures may differ from row to row.

A column's type follows from all of its values: whole numbers stay whole, and become floats where one of them is; lists
of numbers and of texts are lists; whatever else is, or is mixed, becomes text (JSON). A column without any value is of
Parquet's null, which every reader joins with any other type.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from armsight.store.atomic import write_bytes

ROWS = 2000
"""Rows held at once: the table of a hundred thousand jobs is written in less than 100 MB."""
NOTHING, EMPTY, FLAG, WHOLE, NUMBER, TEXT, NUMBERS, TEXTS, JSON = (
    *("nothing", "empty", "flag", "whole", "number", "text", "numbers", "texts", "json"),
)
LARGEST = 2**63
WIDER = {frozenset((WHOLE, NUMBER)): NUMBER, frozenset((EMPTY, NUMBERS)): NUMBERS, frozenset((EMPTY, TEXTS)): TEXTS}
"""What holds both kinds; nothing goes with every kind."""

Rows = Callable[[], Iterable[Mapping[str, Any]]]


def write_result_table(path: Path, rows: Rows) -> int:
    """Write the rows as Parquet in one step, see write_bytes; return how many they are.

    rows() yields them anew each time: once for the types of the columns, once to write. Raises DeviceFailed.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds: dict[str, str] = {}
    for row in rows():
        for name, value in row.items():
            kinds[name] = _both(kinds.get(name, NOTHING), _kind(value))
    types = _types()
    schema = pa.schema([(name, types[kind]) for name, kind in kinds.items()])
    buffer, n = pa.BufferOutputStream(), 0
    with pq.ParquetWriter(buffer, schema, compression="zstd") as writer:
        for some in _some(rows()):
            columns = [
                pa.array([_value(row.get(name), kind) for row in some], type=types[kind])
                for name, kind in kinds.items()
            ]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
            n += len(some)
    write_bytes(path, buffer.getvalue().to_pybytes())
    return n


def _some(rows: Iterable[Mapping[str, Any]]) -> Iterator[list[Mapping[str, Any]]]:
    rest = iter(rows)
    while some := list(islice(rest, ROWS)):
        yield some


def _types() -> Mapping[str, Any]:
    import pyarrow as pa

    text, number = pa.string(), pa.float64()
    lists = {EMPTY: pa.list_(pa.null()), NUMBERS: pa.list_(number), TEXTS: pa.list_(text)}
    return lists | {NOTHING: pa.null(), FLAG: pa.bool_(), WHOLE: pa.int64(), NUMBER: number, TEXT: text, JSON: text}


def _kind(value: Any) -> str:
    if isinstance(value, list):
        if not value:
            return EMPTY
        inner = {_kind(one) for one in value}
        return NUMBERS if inner <= {WHOLE, NUMBER, NOTHING} else TEXTS if inner == {TEXT} else JSON
    if isinstance(value, bool):
        return FLAG
    if isinstance(value, int):
        return WHOLE if -LARGEST <= value < LARGEST else NUMBER
    return (
        NOTHING if value is None else NUMBER if isinstance(value, float) else TEXT if isinstance(value, str) else JSON
    )


def _both(one: str, other: str) -> str:
    if one == other or other == NOTHING:
        return one
    return other if one == NOTHING else WIDER.get(frozenset((one, other)), JSON)


def _value(value: Any, kind: str) -> Any:
    if value is None:
        return None
    if kind == NUMBER:
        return float(value)
    if kind == NUMBERS:
        return [None if one is None else float(one) for one in value]
    if kind == JSON and not isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return value
