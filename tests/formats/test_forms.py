"""read(write(x)) = x, bit for bit, whichever form holds the rows."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st
from made_release import (
    OBJECTS,
    PAPER_F,
    as_schema_1_0,
    made_hand,
    made_hands,
    made_release,
    made_rows,
)

from bidexdata.errors import Contradiction, NotUsable, UnknownChoice, UnknownName
from bidexdata.formats import hdf5
from bidexdata.formats.hdf5_writer import LIBRARY_VERSIONS
from bidexdata.formats.release import Release
from bidexdata.formats.rig_files import ReleaseRig
from bidexdata.formats.rows import ReleaseRows
from bidexdata.formats.tables import ARM_COLUMNS, CONTACT_COLUMNS, GRASP_COLUMNS, VERDICT_COLUMNS
from bidexdata.formats.verify import verify_release
from bidexdata.formats.writer import check_names
from bidexdata.record import FIELDS, GraspBatch, Header, Status
from bidexdata.record.batch import ArmHeader, fill_value

OBJECT = OBJECTS[0]
FORMS = ("both", "parquet", "hdf5")
ROW_TABLES = ("grasps", "contacts", "verdicts/paper-1-f")


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    if a.dtype.kind == "U":
        return a.tolist() == b.tolist()
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def same_table(a: pa.Table, b: pa.Table) -> bool:
    """Like `Table.equals`, but NaN equals itself."""

    def bits(column: pa.ChunkedArray) -> list:
        array = column.combine_chunks()
        nulls = array.is_null().to_pylist()
        flat = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
        if pa.types.is_floating(flat.type):
            flat = flat.to_numpy(zero_copy_only=False).view(np.uint32)
        return [nulls, flat.tolist()]

    assert a.schema == b.schema
    return all(bits(a.column(name)) == bits(b.column(name)) for name in a.column_names)


ARMS = tuple(
    ArmHeader(
        "made", "a" * 64, side, tuple(f"{side}_{k}" for k in range(joints)), 0, (2, 1, 1, 1, 1)
    )
    for side, joints in (("left", 3), ("right", 2))
)
"""Of two arms of different length, so that columns are padded."""


def arbitrary_rows(
    object_id: str, seed: int, n: int, hands, *, contacts=True, arms=()
) -> ReleaseRows:
    """Rows whose numbers are random bits: NaN payloads, infinities and subnormals included."""
    rng = np.random.default_rng(seed)
    counts = {f"{object_id}/300/float": {"ok": n}}
    header = Header(tuple(h.header() for h in hands), counts=counts, arms=arms)

    def column(name):
        field, shape = FIELDS[name], (n, *header.shape(FIELDS[name]))
        if field.dtype == "string":
            return np.array(
                ["".join(map(chr, rng.integers(0x20, 0x2FA0, 4))) for _ in range(n)], np.str_
            )
        if field.dtype == "bool":
            return rng.random(shape) < 0.5
        size = np.dtype(field.dtype).itemsize
        return np.frombuffer(rng.bytes(int(np.prod(shape)) * size), field.dtype).reshape(shape)

    columns = {name: column(name) for name in (*GRASP_COLUMNS, *CONTACT_COLUMNS)}
    if not contacts:
        columns |= {n: np.full_like(columns[n], fill_value(FIELDS[n])) for n in CONTACT_COLUMNS}
    columns["grasp_id"] = np.array([f"{i:016x}" for i in rng.permutation(n)], np.str_)
    columns["object_id"] = np.full(n, object_id)
    columns["size_mm"] = np.full(n, 300, np.int32)
    columns["scene_id"] = np.full(n, f"{object_id}/300/float")
    columns["synth_status"] = np.full(n, Status.OK, np.int8)
    verdicts = {name: column(name) for name in VERDICT_COLUMNS}
    verdicts["verdict_status"] = rng.choice([Status.OK, Status.SLIP], n).astype(np.int8)
    solved = {name: column(name) for name in ARM_COLUMNS} if arms else {}
    if arms:
        solved["arm_status"] = rng.choice([Status.OK, Status.IK_GRASP], n).astype(np.int8)
    return ReleaseRows("run", GraspBatch(header, columns), {PAPER_F: verdicts}, solved)


# One example packs a whole release: shrinking would pack hundreds.
@pytest.mark.parametrize("form", FORMS)
@settings(
    max_examples=5,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@example(seed=0, n=0, one_hand=False, contacts=True, armed=True)
@example(seed=1, n=3, one_hand=True, contacts=False, armed=False)
@example(seed=2, n=4, one_hand=False, contacts=True, armed=True)
@example(seed=679, n=5, one_hand=False, contacts=True, armed=False)  # whose products underflow
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 5),
    one_hand=st.booleans(),
    contacts=st.booleans(),
    armed=st.booleans(),
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_every_field_comes_back_bit_for_bit(
    tmp_path_factory, form, seed, n, one_hand, contacts, armed
):
    object_id = "größe-0badf00d"
    hands = (made_hand("right"),) if one_hand else made_hands()
    arms = ARMS if armed and not one_hand else ()
    rows = arbitrary_rows(object_id, seed, n, hands, contacts=contacts, arms=arms)
    out = made_release(
        tmp_path_factory.mktemp("bits") / "release",
        (object_id,),
        rows_of=lambda _: [rows],
        hands=hands,
        form=form,
        rig=ReleaseRig(arms, {"name": "made", "models": {}, "spec": {}}, "") if arms else None,
    )
    release = Release.open(out)
    assert (release.form, release.header.arms) == (form, arms)
    assert release.hands == tuple(h.header() for h in hands)
    for configuration in release.configurations:
        read = release.grasps(configuration=configuration)
        mine = np.flatnonzero(rows.batch[configuration])
        mine = mine[np.argsort(rows.batch["grasp_id"][mine])]
        expected = {**rows.batch.columns, **rows.verdicts[PAPER_F]}
        assert set(read.columns) == set(expected)
        for name, value in expected.items():
            assert same_bits(read[name], value[mine]), name
        solved = release.with_arms(read) if arms else read
        for name, value in rows.arms.items():
            assert same_bits(solved[name], value[mine]), name
        numbers = [n for n in expected if expected[n].dtype.kind in "if" and n in known(release)]
        mapped = hdf5.map_columns(out, configuration, "train", numbers)
        for name in numbers:
            assert same_bits(np.ascontiguousarray(mapped[name]), expected[name][mine]), name


def known(release: Release) -> list[str]:
    return [n for t in ("grasps", "contacts") for n in release.table_schema(t).names]


@pytest.fixture(scope="module", params=["parquet", "hdf5"])
def alone(request, tmp_path_factory) -> Release:
    """The release of the fixture `packed` in one form alone."""
    root = tmp_path_factory.mktemp("alone") / "release"
    return Release.open(made_release(root, form=request.param))


def test_all_forms_hold_the_same_rows(alone, packed):
    both = Release.open(packed)
    for configuration in both.configurations:
        for table in ROW_TABLES:
            assert alone.table_schema(table) == both.table_schema(table)
            for split in (None, *both.split_names):
                place = (table, configuration, split)
                parts = zip(alone.row_groups(*place), both.row_groups(*place), strict=True)
                assert all(same_table(mine, theirs) for mine, theirs in parts)
        assert same_table(alone.index(configuration), both.index(configuration))
        for object_id in both.object_ids:
            mine = alone.grasps(object_id, configuration=configuration)
            theirs = both.grasps(object_id, configuration=configuration)
            assert len(mine) > 0
            assert all(same_bits(mine[name], theirs[name]) for name in theirs.columns)
    assert same_table(alone.objects, both.objects)
    assert same_table(alone.scenes, both.scenes)


def test_a_form_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(UnknownChoice, match="--form must be one of both, parquet, hdf5, not 'csv'"):
        check_names(tmp_path / "r", "made", "1.0.0", "csv")


def test_rows_stand_in_one_form_alone_where_asked_for(alone):
    assert (alone.path / "grasps.h5").is_file() == (alone.form == "hdf5")
    assert bool(alone.table_files("grasps", "selected")) == (alone.form == "parquet")
    kinds = {path.suffix for path in alone.path.glob("*/**/*.parquet")}
    assert kinds == (set() if alone.form == "hdf5" else {".parquet"})


def test_the_training_form_is_rebuilt_byte_for_byte(copied):
    before = (copied / "grasps.h5").read_bytes()
    (copied / "grasps.h5").unlink()
    hdf5.rebuild_training_form(copied)
    assert (copied / "grasps.h5").read_bytes() == before


@pytest.mark.parametrize("part", ["values", "contacts"])
def test_the_training_form_can_be_left_out(packed, tmp_path, part):
    out = made_release(tmp_path / "r", form="parquet")
    assert hdf5.map_values(out, "selected", "train", part) is None
    read = hdf5.read_values(out, "selected", "train", part)
    mapped = hdf5.map_values(packed, "selected", "train", part)
    assert read.columns == mapped.columns
    assert read.values.tobytes() == np.asarray(mapped.values).tobytes()
    names = ["joints", "contact_point", "suc_f", "suc_l", "contact_index", "selected", "seed"]
    columns = [hdf5.map_columns(root, "selected", "train", names) for root in (out, packed)]
    for name in names:
        assert same_bits(*(np.ascontiguousarray(c[name]) for c in columns))
    assert isinstance(columns[1]["joints"], np.memmap)


def test_integers_of_the_training_form_are_those_of_the_tables(packed):
    release = Release.open(packed)
    batch = release.grasps(split="train")
    with h5py.File(packed / "grasps.h5") as file:
        group = file["selected/train"]
        for name in ("size_mm", "contact_index", "region_id", "seed", "selected", "synth_status"):
            np.testing.assert_array_equal(group[name][:], batch[name])
        np.testing.assert_array_equal(group["suc_f"][:] == 1, batch["success"])
        assert set(group["suc_l"][:]) == {-1}
        assert group["size_mm"].attrs["unit"] == "mm"


def test_the_file_says_what_it_is(packed):
    release = Release.open(packed)
    with h5py.File(packed / "grasps.h5") as file:
        said = dict(file.attrs)
        assert Header.from_json(said.pop("header")) == release.header
        assert said == {
            "schema_version": release.manifest["schema_version"],
            "dataset": "made",
            "dataset_version": "1.0.0",
            "generator": "bidexdata",
            "generator_version": release.manifest["generator"]["version"],
        }
        for part, one in (("values", "joints"), ("contacts", "contact_point")):
            layout = {c["name"]: c for c in json.loads(file[f"audit/test/{part}"].attrs["columns"])}
            assert layout[one]["unit"] == FIELDS[one].unit
            assert layout[one]["description"] == FIELDS[one].description
            assert sum(c["width"] for c in layout.values()) == file[f"audit/test/{part}"].shape[1]


def test_every_array_begins_where_numpy_gathers_without_a_copy(packed, tmp_path):
    alone = made_release(tmp_path / "r", form="hdf5")
    offsets = []

    def note(_: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.size:
            offsets.append(item.id.get_offset())

    for root in (packed, alone):
        with h5py.File(root / "grasps.h5") as file:
            file.visititems(note)
    assert len(offsets) > 100
    assert not [at for at in offsets if at % 64]
    mapped = hdf5.map_values(packed, "selected", "train")
    assert mapped.values.flags.aligned


def test_columns_that_are_not_there_are_named(packed, tmp_path):
    with pytest.raises(UnknownName, match="did you mean 'joints'"):
        hdf5.map_columns(packed, "selected", "train", ["joint"])
    bare = made_release(tmp_path / "r", (OBJECT,), form="parquet")
    with pytest.raises(UnknownName, match="grasp_id"):
        hdf5.map_columns(bare, "selected", "train", ["grasp_id"])


@pytest.mark.parametrize("part", ["values", "contacts"])
def test_a_partial_download_is_named_with_what_reads_it(tmp_path, part):
    out = made_release(tmp_path / "r", form="parquet")
    table = {"values": "grasps"}.get(part, part)
    name = f"{table}/train-00000.parquet"
    (out / name).unlink()
    column = {"values": "seed"}.get(part, "contact_index")
    for read in (
        lambda: hdf5.read_values(out, "selected", "train", part),
        lambda: hdf5.map_columns(out, "selected", "train", [column]),
    ):
        with pytest.raises(NotUsable, match=f"{name} is not there.*BiDexStream"):
            read()
    alone = made_release(tmp_path / "alone", form="hdf5")
    (alone / "grasps.h5").unlink()
    with pytest.raises(NotUsable, match=r"grasps\.h5 is not there"):
        hdf5.read_values(alone, "selected", "train", part)


def test_the_training_form_is_of_the_file_versions_that_the_format_page_states(packed):
    data = (packed / "grasps.h5").read_bytes()[:9]
    assert data == b"\x89HDF\r\n\x1a\n\x03"  # superblock 3: version 1.10 of the library and later
    page = (Path(__file__).parents[2] / "docs" / "format.md").read_text(encoding="utf-8")
    assert 'libver=("v110", "v114")' in page
    assert LIBRARY_VERSIONS == ("v110", "v114")


@pytest.mark.parametrize("cut", [100, 5000])
def test_a_file_that_is_cut_short_is_a_contradiction(copied, cut):
    path = copied / "grasps.h5"
    path.write_bytes(path.read_bytes()[:cut])
    for read in (hdf5.map_values, lambda *place: hdf5.map_columns(*place, ["joints"])):
        with pytest.raises(Contradiction, match="not a training form"):
            read(copied, "selected", "train")


def test_one_array_of_schema_1_2_serves_both_parts(copied):
    with h5py.File(copied / "grasps.h5", "r+") as file:
        group = file["selected/train"]
        parts = [group.pop(n) for n in ("values", "contacts")]
        layouts = [json.loads(p.attrs["columns"]) for p in parts]
        joined = group.create_dataset("values", data=np.concatenate([p[:] for p in parts], axis=1))
        joined.attrs["columns"] = json.dumps([*layouts[0], *layouts[1]])
    either = [hdf5.map_values(copied, "selected", "train", p) for p in ("values", "contacts")]
    assert either[0].columns == either[1].columns
    place, shape = either[0].columns["contact_point"]
    batch = Release.open(copied).grasps(split="train")
    found = either[0].values[:, place].reshape(-1, *shape)
    assert same_bits(np.ascontiguousarray(found), batch["contact_point"])
    mapped = hdf5.map_columns(copied, "selected", "train", ["contact_point"])
    assert same_bits(np.ascontiguousarray(mapped["contact_point"]), batch["contact_point"])


def test_rows_of_an_older_schema_are_read_by_object(copied):
    as_schema_1_0(copied)
    release = Release.open(copied)
    assert len(release.grasps(OBJECT)) == made_rows(OBJECT).batch["selected"].sum()


@pytest.mark.parametrize("full", [False, True])
def test_every_form_keeps_the_laws(alone, full):
    report = verify_release(alone.path, full=full)
    assert report.ok, report.to_dict()


def test_a_column_of_fewer_rows_is_found(tmp_path):
    root = made_release(tmp_path / "r", form="hdf5")
    with h5py.File(root / "grasps.h5", "r+") as file:
        group = file["selected/train"]
        short = group.pop("seed")[:-1]
        group.create_dataset("seed", data=short)
    with pytest.raises(Contradiction, match="columns of grasps differ in length"):
        list(Release.open(root).row_groups("grasps"))
