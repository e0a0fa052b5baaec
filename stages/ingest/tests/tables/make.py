"""Make the tables of this folder: the same five rows by the programs that write data sets.

    pip install pyarrow polars pandas fastparquet duckdb && python make.py

Read by the test `layouts::parquet_table::tests::what_the_usual_writers_write_is_read`.
"""

import decimal
from pathlib import Path

import duckdb
import fastparquet
import pandas
import polars
import pyarrow
import pyarrow.parquet

HERE = Path(__file__).parent
ROWS = range(5)
WHOLE = [3 * row for row in ROWS]
REAL = [0.5 * row - 1 for row in ROWS]
TEXT = [f"task {row}" for row in ROWS]
STATE = [[row + 0.25, -row, 8.0] for row in ROWS]
TEXTS = [[f"task {row}", "more"] for row in ROWS]
HOLES = [None if row == 2 else 0.5 * row - 1 for row in ROWS]


def arrow(path):
    """Every type of pyarrow that holds numbers or text, two rows a row group."""
    of = pyarrow.array
    columns = {}
    for name in "int8 int16 int32 int64 uint8 uint16 uint32 uint64".split():
        columns[name] = of(WHOLE, getattr(pyarrow, name)())
    for name in "float16 float32 float64".split():
        columns[name] = of(REAL, getattr(pyarrow, name)())
    columns["large"] = of([2**63 + 2048 * row for row in ROWS], pyarrow.uint64())
    columns["bool"] = of([row % 2 == 1 for row in ROWS])
    for name, kind in [("decimal", pyarrow.decimal128(9, 2)), ("decimal32", pyarrow.decimal32(9, 2))]:
        columns[name] = of([decimal.Decimal(repr(value)) for value in REAL], kind)
    columns["holes"] = of(HOLES)
    columns["text"] = of(TEXT)
    columns["large_text"] = of(TEXT, pyarrow.large_string())
    columns["view"] = of(TEXT, pyarrow.string_view())
    columns["dictionary"] = of(TEXT).dictionary_encode()
    columns["nothing"] = pyarrow.nulls(5)
    columns["state"] = of(STATE, pyarrow.list_(pyarrow.float32()))
    columns["large_state"] = of(STATE, pyarrow.large_list(pyarrow.float64()))
    columns["fixed_state"] = of(STATE, pyarrow.list_(pyarrow.float32(), 3))
    columns["texts"] = of(TEXTS, pyarrow.list_(pyarrow.string()))
    columns["empty"] = of([[]] * 5, pyarrow.list_(pyarrow.null()))
    columns["ragged"] = of([[1.0] * row for row in ROWS])
    columns["list_hole"] = of([[1.0, None]] * 5)
    columns["missing_list"] = of([[1.0], None, [1.0], [1.0], [1.0]])
    columns["bytes"] = of([b"x"] * 5)
    columns["time"] = of([0] * 5, pyarrow.timestamp("us"))
    columns["date"] = of([0] * 5, pyarrow.date32())
    columns["pair"] = of([{"a": 1, "b": 2}] * 5)
    columns["single"] = of([{"a": 1}] * 5)
    columns["nested"] = of([[[1.0]]] * 5)
    columns["pairs"] = of([[{"a": 1.0}]] * 5)
    pyarrow.parquet.write_table(pyarrow.table(columns), path, row_group_size=2)


def common():
    return {"int64": WHOLE, "float64": REAL, "holes": HOLES, "text": TEXT, "state": STATE, "texts": TEXTS}


arrow(HERE / "pyarrow.parquet")
frame = polars.DataFrame(common(), strict=False)
frame.write_parquet(HERE / "polars.parquet", compression="zstd", row_group_size=2)
pandas.DataFrame(common()).to_parquet(HERE / "pandas.parquet")
table = pandas.DataFrame({key: value for key, value in common().items() if not key.startswith("state")})
fastparquet.write(HERE / "fastparquet.parquet", table.drop(columns="texts"), row_group_offsets=[0, 2])
arrow_table = pyarrow.table(common())
duckdb.sql("from arrow_table").write_parquet(str(HERE / "duckdb.parquet"))
