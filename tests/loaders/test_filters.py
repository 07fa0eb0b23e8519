import numpy as np
import pyarrow as pa
import pytest

from bidexdata.errors import BadConfig, UnknownName
from bidexdata.loaders.filters import columns_named, matching_rows

INDEX = pa.table(
    {
        "size_mm": pa.array([300, 500, 500, 800], pa.int32()),
        "suc_f": pa.array([True, True, False, None]),
        "object_id": ["a", "b", "b", "c"],
        "pd": pa.array([0.001, float("nan"), 0.003, 0.004], pa.float32()),
    }
)


@pytest.mark.parametrize(
    ("where", "rows"),
    [
        (None, [0, 1, 2, 3]),
        ("suc_f", [0, 1]),
        ("not suc_f", [2]),  # null is neither
        ("suc_f == True", [0, 1]),
        ("suc_f and size_mm <= 500", [0, 1]),
        ("suc_f and size_mm < 500 or object_id == 'c'", [0, 3]),
        ("300 < size_mm <= 500", [1, 2]),
        ("object_id in ['a', 'c']", [0, 3]),
        ("object_id not in ('a', 'c')", [1, 2]),
        ("pd < 0.0035", [0, 2]),  # NaN is not less
        ("pd > -1", [0, 2, 3]),
        ("not (size_mm == 500)", [0, 3]),
        (" size_mm != 500 ", [0, 3]),
        ("size_mm > 10000", []),
        ({}, [0, 1, 2, 3]),
        ({"suc_f": True, "size_mm": 500}, [1]),
        ({"size_mm": [300, 800]}, [0, 3]),
        ({"object_id": {"b"}}, [1, 2]),
        (lambda c: c["size_mm"] > 400, [1, 2, 3]),
        (lambda c: c["suc_f"], [0, 1]),  # null reads as False
        (lambda c: np.char.startswith(c["object_id"], "b"), [1, 2]),
    ],
)
def test_rows_are_chosen(where, rows):
    assert matching_rows(where, INDEX).tolist() == rows


@pytest.mark.parametrize(
    "where",
    [
        "__import__('os').system('true')",
        "size_mm.real > 3",
        "[x for x in (1, 2)]",
        "size_mm + 1 > 3",
        "lambda: 1",
        "size_mm if suc_f else pd",
        "size_mm in range(3)",
        "object_id is 'a'",
        "1",
        "size_mm ==",
        "",
        "size_mm = 3",
        "object_id == b'a'",
        "object_id == 3",
        lambda c: np.zeros(3, bool),
        lambda c: np.zeros(4),
    ],
)
def test_anything_else_is_refused(where):
    with pytest.raises(BadConfig):
        matching_rows(where, INDEX)


@pytest.mark.parametrize(
    "where",
    [
        "not " * 3000 + "suc_f",
        "not " * 150 + "suc_f",
        "(suc_f and not " * 3000 + "suc_f" + ")" * 3000,
        "(" * 3000 + "suc_f" + ")" * 3000,
        "suc_f and " * 10_000 + "suc_f",  # would overflow the stack of Arrow
        "size_mm < " * 10_000 + "3",
    ],
)
def test_what_is_too_deep_is_refused_in_one_sentence(where):
    for read in (columns_named, lambda w: matching_rows(w, INDEX)):
        with pytest.raises(BadConfig) as caught:
            read(where)
        assert len(str(caught.value)) < 500


def test_many_conditions_and_any_number_of_values_are_read():
    assert matching_rows("not " * 90 + "suc_f", INDEX).tolist() == [0, 1]
    assert matching_rows("suc_f and " * 900 + "suc_f", INDEX).tolist() == [0, 1]
    many = ", ".join(map(str, range(5000)))
    assert matching_rows(f"size_mm in [{many}]", INDEX).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("where", ["size > 3", "sucf", {"sizes": 1}])
def test_unknown_columns_are_named(where):
    with pytest.raises(UnknownName, match="known: size_mm"):
        matching_rows(where, INDEX)


def test_only_the_columns_in_question_are_read():
    assert columns_named("suc_f and 3 < size_mm") == ["size_mm", "suc_f"]
    assert columns_named({"pd": 1}) == ["pd"]
    assert columns_named(None) == []
    assert columns_named(lambda c: c) is None


def test_large_tables_keep_their_order():
    index = pa.table({"size_mm": pa.array(np.arange(300_000) % 7, pa.int32())})
    rows = matching_rows("size_mm == 3", index)
    np.testing.assert_array_equal(rows, np.arange(3, 300_000, 7))
