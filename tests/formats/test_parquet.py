import itertools

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bidexdata.errors import Contradiction
from bidexdata.formats import parquet

SCHEMA = pa.schema(
    [
        pa.field("object_id", pa.string(), nullable=False),
        pa.field("row", pa.int32(), nullable=False),
        pa.field(
            "x", pa.list_(pa.field("element", pa.float32(), nullable=False), 3), nullable=False
        ),
        pa.field("flag", pa.bool_()),
    ]
)


def rows(object_id, start, n):
    rng = np.random.default_rng(start)
    flat = pa.array(rng.normal(size=3 * n).astype(np.float32))
    arrays = [
        pa.array([object_id] * n, pa.string()),
        pa.array(np.arange(start, start + n, dtype=np.int32)),
        pa.FixedSizeListArray.from_arrays(flat, type=SCHEMA.field("x").type),
        pa.array([None, True, False][start % 3 :][:1] * n, pa.bool_()),
    ]
    return pa.Table.from_arrays(arrays, schema=SCHEMA)


def write(folder, tables, **options):
    writer = parquet.TableWriter(folder, "train", SCHEMA, ("object_id", "row"), **options)
    for table in tables:
        writer.add_object(table)
    writer.close()
    return sorted(folder.iterdir())


@pytest.fixture
def small_groups(monkeypatch):
    monkeypatch.setattr(parquet, "ROW_GROUP", 64)


@pytest.mark.usefixtures("small_groups")
def test_bytes_do_not_depend_on_how_rows_arrive(tmp_path):
    whole = pa.concat_tables([rows("a", 0, 150), rows("b", 150, 50)])
    cuts = [0, 1, 64, 65, 129, 150, 200]
    pieces = [whole.slice(i, j - i) for i, j in itertools.pairwise(cuts)]
    (first,) = write(tmp_path / "one", [whole])
    (second,) = write(tmp_path / "many", pieces)
    assert first.read_bytes() == second.read_bytes()
    assert parquet.row_counts(first) == [64, 64, 64, 8]
    assert parquet.read_table(first).equals(whole)


@pytest.mark.usefixtures("small_groups")
def test_files_are_cut_between_objects_only(tmp_path):
    tables = [
        rows(o, 1000 * i, n)
        for i, (o, n) in enumerate([("a", 90), ("b", 30), ("c", 200), ("d", 0), ("e", 5)])
    ]
    files = write(tmp_path, tables, rows_per_file=100)
    owners = [set(parquet.read_table(f).column("object_id").to_pylist()) for f in files]
    assert owners == [{"a", "b"}, {"c"}, {"e"}]
    assert pa.concat_tables([parquet.read_table(f) for f in files]).equals(pa.concat_tables(tables))


def test_a_table_without_rows_is_one_file_with_its_schema(tmp_path):
    (file,) = write(tmp_path, [])
    assert parquet.read_table(file).equals(SCHEMA.empty_table())
    assert parquet.read_table(file, ["row"]).column_names == ["row"]
    assert parquet.read_schema(file).equals(SCHEMA)


def test_encodings_are_those_that_were_measured_best(tmp_path):
    (file,) = write(tmp_path, [rows("a", 0, 500)])
    group = pq.ParquetFile(file).metadata.row_group(0)
    columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
    assert all(c.compression == "ZSTD" for c in columns.values())
    assert "BYTE_STREAM_SPLIT" in columns["x.list.element"].encodings
    assert "RLE_DICTIONARY" in columns["object_id"].encodings
    assert "RLE_DICTIONARY" not in columns["row"].encodings
    assert all(c.has_column_index and c.has_offset_index for c in columns.values())
    assert len(group.sorting_columns) == 2


def test_any_flipped_bit_of_a_page_is_refused(tmp_path):
    (file,) = write(tmp_path, [rows("a", 0, 500)])
    data = file.read_bytes()
    group = pq.ParquetFile(file).metadata.row_group(0)
    column = next(
        c for c in (group.column(i) for i in range(4)) if c.path_in_schema.startswith("x")
    )
    end = column.data_page_offset + column.total_compressed_size
    rng = np.random.default_rng(0)
    # The last 5,000 bytes of the chunk are page data, past the page's header.
    for at in rng.integers(end - 5000, end, 40):
        damaged = bytearray(data)
        damaged[at] ^= 1 << rng.integers(8)
        file.write_bytes(damaged)
        with pytest.raises(Contradiction, match="damaged Parquet"):
            parquet.read_table(file)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"not parquet at all, but long enough to look"])
def test_what_is_no_parquet_file_is_refused(tmp_path, content):
    file = tmp_path / "x.parquet"
    file.write_bytes(content)
    for read in (parquet.read_table, parquet.read_schema, parquet.row_counts):
        with pytest.raises(Contradiction, match="damaged Parquet"):
            read(file)


@pytest.mark.parametrize("read", [parquet.read_table, parquet.read_schema, parquet.row_counts])
def test_a_missing_file_is_not_called_damaged(tmp_path, read):
    with pytest.raises(Contradiction, match=r"scenes\.parquet is missing$"):
        read(tmp_path / "scenes.parquet")
