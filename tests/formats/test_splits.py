import pytest
from hypothesis import given
from hypothesis import strategies as st

from bidexdata.formats.splits import split_objects

names = st.text("abcdef0123456789-", min_size=1, max_size=12)
libraries = st.dictionaries(names, st.sampled_from("pqrstuvwxyz"), min_size=1, max_size=30)


@given(libraries, st.floats(0.01, 0.99), st.integers(0, 99))
def test_a_split_is_a_partition_that_keeps_shapes_together(shapes, fraction, seed):
    splits = split_objects(shapes, test_fraction=fraction, seed=seed)
    assert set(splits) == set(shapes)
    by_shape = {
        shape: {splits[o] for o in shapes if shapes[o] == shape} for shape in shapes.values()
    }
    assert all(len(where) == 1 for where in by_shape.values())
    if len(by_shape) > 1:
        assert set(splits.values()) == {"train", "test"}
    else:
        assert set(splits.values()) == {"train"}
    assert (
        split_objects(dict(reversed(shapes.items())), test_fraction=fraction, seed=seed) == splits
    )


def test_a_fifth_of_the_objects_is_for_testing():
    shapes = {f"o{i}": str(i) for i in range(1000)}
    splits = split_objects(shapes)
    assert list(splits.values()).count("test") == 200
    assert splits != split_objects(shapes, seed=1)


def test_adding_objects_moves_few():
    shapes = {f"o{i}": str(i) for i in range(1000)}
    before = split_objects(shapes)
    after = split_objects({**shapes, **{f"p{i}": f"p{i}" for i in range(100)}})
    assert sum(before[o] != after[o] for o in shapes) < 30


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.1])
def test_impossible_shares_are_refused(fraction):
    with pytest.raises(ValueError, match="test_fraction"):
        split_objects({"a": "1"}, test_fraction=fraction)
