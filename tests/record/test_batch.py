import random
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bidexdata.errors import Contradiction
from bidexdata.record import FIELDS, GraspBatch, HandHeader, Header, Status
from bidexdata.record.batch import (
    SCHEMA_VERSION,
    ArmHeader,
    BadRecord,
    empty_columns,
    fill_value,
    in_metres,
)
from bidexdata.record.fields import (
    KEY_FRAMES,
    PHASES,
    SIDES,
    STAGES,
    columns_of_table,
    columns_written_by,
)

# numpy drops trailing NULs of strings; no identity of ours holds one.
text = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=8)


@contextmanager
def drawing_nothing():
    """Leave Python's generator as it was.

    The run-time check of annotations looks at a random item of each container, and hypothesis
    warns of strategies that draw from anything but itself.
    """
    state = random.getstate()
    yield
    random.setstate(state)


@st.composite
def headers(draw):
    hands = []
    for side in draw(st.sampled_from([("left", "right"), ("left",), ("right",)])):
        joints = draw(st.lists(text, max_size=3, unique=True))
        contacts = draw(st.lists(text, max_size=3, unique=True))
        hands.append((draw(text), side, draw(text), tuple(joints), tuple(contacts), "palm"))
    arms = []
    for hand in hands if draw(st.booleans()) else ():
        joints = tuple(draw(st.lists(text, max_size=3, unique=True)))
        knots = tuple(draw(st.lists(st.integers(1, 4), max_size=5)))
        arms.append((draw(text), draw(text), hand[1], joints, draw(st.integers(0, 2)), knots))
    counts = draw(st.dictionaries(text, st.dictionaries(text, st.integers(0, 9)), max_size=2))
    prints, version = {"synth": draw(text)}, draw(text)
    with drawing_nothing():
        made = tuple(HandHeader(*hand) for hand in hands)
        carried = tuple(ArmHeader(*arm) for arm in arms)
        return Header(made, prints, version, counts, extra={"new": [1, None]}, arms=carried)


@st.composite
def batches(draw):
    header, n = draw(headers()), draw(st.integers(0, 4))
    names = draw(st.lists(st.sampled_from(sorted(FIELDS)), min_size=1, unique=True))
    columns = {}
    for name in names:
        column = FIELDS[name]
        if column.dtype == "string":
            values = draw(st.lists(text, min_size=n, max_size=n))
            columns[name] = np.array(values, dtype=np.str_)
        else:
            with drawing_nothing():
                shape = (n, *header.shape(column))
            columns[name] = draw(hnp.arrays(column.dtype, shape))
    with drawing_nothing():
        return GraspBatch(header, columns)


def assert_same(a: GraspBatch, b: GraspBatch):
    assert a.header == b.header
    assert list(a.columns) == list(b.columns)
    for name, value in a.columns.items():
        other = b[name]
        if value.dtype.kind == "U":
            assert value.tolist() == other.tolist()
            continue
        assert value.dtype == other.dtype
        assert value.shape == other.shape
        assert value.tobytes() == other.tobytes(), name


@settings(deadline=None)
@given(batches())
def test_arrow_gives_every_bit_back(batch):
    assert_same(GraspBatch.from_arrow(batch.to_arrow()), batch)


@settings(deadline=None)
@given(batches())
def test_parts_join_to_the_whole(batch):
    cut = len(batch) // 2
    joined = GraspBatch.concat([batch.select(slice(0, cut)), batch.select(slice(cut, None))])
    for name, value in batch.columns.items():
        np.testing.assert_array_equal(joined[name], value)
    assert joined.header.counts == batch.header.counts


@given(headers())
def test_a_header_survives_json_and_keeps_unknown_keys(header):
    assert Header.from_json(header.to_json()) == header
    assert header.extra == {"new": [1, None]}


HAND = HandHeader("h", "left", "s", ("j0", "j1"), ("c0",), "palm")
OTHER = HandHeader("h", "right", "s", ("j0",), (), "palm")
HEADER = Header((HAND, OTHER))


def small(**columns):
    return GraspBatch(HEADER, {"grasp_id": np.array(["a", "b"]), **columns})


def test_axes_follow_the_largest_hand():
    assert HEADER.shape(FIELDS["joints"]) == (2, len(STAGES), 2)
    assert HEADER.shape(FIELDS["contact_point"]) == (2, 1, 3)
    assert len(SIDES) == 2


def test_axes_of_arms_follow_the_longest_chain_and_the_knots_of_all_phases():
    left = ArmHeader("rig", "s", "left", ("a0", "a1", "w0"), 1, (4, 2, 1, 1, 1))
    right = replace(left, side="right", joint_names=("a0", "a1"), wrist_joints=0)
    header = Header((HAND, OTHER), arms=(left, right))
    assert header.shape(FIELDS["arm_path"]) == (2, 10, 3)
    assert header.shape(FIELDS["arm_joints"]) == (2, len(KEY_FRAMES), 3)
    assert len(PHASES) == len(KEY_FRAMES) - 1
    assert header.shape(FIELDS["arm_time"]) == (10,)
    alone = GraspBatch(header, empty_columns(header, columns_of_table("arms"), 1))
    with pytest.raises(BadRecord, match="different arms"):
        GraspBatch.concat([alone, replace(alone, header=replace(header, arms=(left, left)))])


def test_a_header_without_arms_names_none_and_has_axes_of_one():
    assert "arms" not in HEADER.to_json()
    assert HEADER.shape(FIELDS["arm_path"]) == (2, 1, 1)


def test_a_hand_without_contacts_still_has_a_padded_column():
    header = Header((OTHER,))
    batch = GraspBatch(header, empty_columns(header, ("contact_index", "contact_point"), 2))
    assert batch.contact_index.tolist() == [[[-1]], [[-1]]]
    assert_same(GraspBatch.from_arrow(batch.to_arrow()), batch)


def test_a_header_without_hands_is_refused_with_a_sentence():
    batch = GraspBatch(Header(()), {"hand_pos": np.zeros((1, 0, 3, 3), np.float32)})
    with pytest.raises(BadRecord, match="names no hand"):
        batch.to_arrow()


def test_padding_values_are_those_of_the_table():
    columns = empty_columns(HEADER, tuple(FIELDS), 3)
    batch = GraspBatch(HEADER, columns)
    assert np.isnan(batch.hand_pos).all()
    assert (batch.contact_index == -1).all()
    assert not batch.selected.any()
    assert batch.scene_id.tolist() == ["", "", ""]
    assert fill_value(FIELDS["steps"]) == -1


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"nonsense": np.zeros(2)}, "not in the field table"),
        ({"size_mm": np.zeros(2, np.int64)}, "must be int32, not int64"),
        ({"scene_id": np.zeros(2)}, "must be string"),
        ({"object_pos": np.zeros((2, 4), np.float32)}, r"must have shape \(N, 3\)"),
        ({"size_mm": np.zeros(3, np.int32)}, "differ in length"),
    ],
)
def test_columns_that_contradict_the_table_are_refused(columns, said):
    with pytest.raises(BadRecord, match=said):
        small(**columns)


def test_columns_are_appended_never_recomputed():
    batch = small().with_columns(size_mm=np.array([300, 500], np.int32))
    assert batch.size_mm.tolist() == [300, 500]
    with pytest.raises(BadRecord, match="never recomputed"):
        batch.with_columns(size_mm=np.array([1, 2], np.int32))


def test_missing_columns_say_what_there_is():
    with pytest.raises(KeyError, match="it has grasp_id"):
        small()["joints"]
    with pytest.raises(AttributeError, match="no column 'joints'"):
        _ = small().joints
    with pytest.raises(AttributeError):
        _ = small().nonsense
    assert "grasp_id" in small()
    assert "joints" not in small()


def test_different_hands_or_columns_do_not_join():
    other = GraspBatch(Header((HAND,)), {"grasp_id": np.array(["c"])})
    with pytest.raises(BadRecord, match="different hands"):
        GraspBatch.concat([small(), other])
    with pytest.raises(BadRecord, match="size_mm"):
        GraspBatch.concat([small(), small(size_mm=np.zeros(2, np.int32))])
    with pytest.raises(BadRecord, match="nothing"):
        GraspBatch.concat([])


def test_joining_keeps_only_fingerprints_that_agree():
    a = GraspBatch(Header((HAND,), {"synth": "1", "library": "x"}), {"grasp_id": np.array(["a"])})
    b = GraspBatch(Header((HAND,), {"synth": "2", "library": "x"}), {"grasp_id": np.array(["b"])})
    assert GraspBatch.concat([a, b]).header.fingerprints == {"library": "x"}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema_version": "1.0"}', "\x00"])
def test_damaged_headers_are_contradictions(text):
    with pytest.raises(Contradiction, match="unreadable bidexdata header"):
        Header.from_json(text)


def test_a_newer_major_schema_names_the_upgrade_and_a_newer_minor_reads():
    ours = f'"schema_version":"{SCHEMA_VERSION}"'
    newer = HEADER.to_json().replace(ours, '"schema_version":"2.0"')
    with pytest.raises(Contradiction, match="pip install -U bidexdata"):
        Header.from_json(newer)
    minor = HEADER.to_json().replace(ours, '"schema_version":"1.7"')
    assert Header.from_json(minor).hands == HEADER.hands


def test_a_table_without_our_header_is_refused():
    with pytest.raises(Contradiction, match="no bidexdata header"):
        GraspBatch.from_arrow(pa.table({"grasp_id": ["a"]}))


def test_field_metadata_reaches_the_schema():
    meta = small().to_arrow().schema.field("grasp_id").metadata
    assert meta[b"written_by"] == b"synth"
    assert b"16 hex" in meta[b"description"]


def test_the_field_table_is_sane():
    for field in FIELDS.values():
        assert set(field.axes) <= set("HSJCAKW") | {"3", "4"}, field.name
        assert field.description
        assert field.name.endswith("_quat_wxyz") == (field.axes[-1:] == ("4",))
    assert "success" in columns_written_by("validate")
    assert set(columns_of_table("contacts")) == {
        n for n in FIELDS if n.startswith(("contact_i", "contact_p", "contact_f", "force_s"))
    } | {"contact_normal"}
    assert Status.OK == 0


def test_rows_of_schema_1_0_get_the_size_that_their_millimetres_say():
    mm = np.array([300, 1], np.int32)
    old = GraspBatch(replace(HEADER, schema_version="1.0"), {"size_mm": mm})
    read = GraspBatch.from_arrow(old.to_arrow())
    assert read.columns["size"].tolist() == np.float32([0.3, 0.001]).tolist()
    assert read.columns["size"].dtype == np.float32
    # Newer rows are what they are, and a batch in memory falls back when it is asked.
    new = GraspBatch.from_arrow(GraspBatch(HEADER, {"size_mm": mm}).to_arrow())
    assert "size" not in new
    assert new.size.tolist() == new["size"].tolist() == read.size.tolist()
    with pytest.raises(KeyError, match="no column 'size'"):
        small()["size"]


def test_whole_millimetres_come_back_exactly_from_float32():
    for mm in range(1, 3000):
        assert in_metres(np.float32(mm / 1000)) == mm / 1000
    for size in np.random.default_rng(0).random(100).astype(np.float32):
        assert np.float32(in_metres(size)) == size
