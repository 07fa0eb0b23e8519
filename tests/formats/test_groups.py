"""Groups of tested grasps: counted by hand, in any order, and the same from a run and a release."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made_release import PAPER_F, made_hands, made_release, made_rows, made_verdicts

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.figures import Tally
from bidexdata.formats.groups import BOUNDED, BY, GroupTally, hands_label
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.metric_text import SHOWN, metric_text
from bidexdata.formats.release import Release
from bidexdata.formats.verify import verify_release
from bidexdata.record import FIELDS, Header, Status
from bidexdata.record.fields import ANALYTIC, MEASURED, METRICS, columns_written_by
from bidexdata.record.rates import clustered_interval
from bidexdata.runs.info import describe
from bidexdata.validation.analytic import AnalyticMetrics
from bidexdata.validation.metrics import Metrics

OBJECTS = tuple(f"box-{i:08d}" for i in range(12))
HANDS = "made left, made right"


def made_columns(seed: int, n: int = 200) -> dict[str, np.ndarray]:
    """Rows of objects, sizes and statuses at random, some metrics not measured."""
    rng = np.random.default_rng(seed)
    columns = {
        "object_id": rng.choice(OBJECTS, n),
        "size_mm": rng.choice(np.array([300, 500, 1000], np.int32), n),
        "setting": rng.choice(np.array(["floating", "tabletop"]), n),
        "verdict_status": rng.choice(np.array([Status.OK, Status.SLIP, Status.TURNED], np.int8), n),
        "contact_number": rng.integers(-1, 12, n).astype(np.int16),
    }
    for name in ("pd", "spd", "cdc", "drift_pos"):
        values = rng.gamma(1.0, 0.003, n).astype(np.float32)
        columns[name] = np.where(rng.random(n) < 0.1, np.float32(np.nan), values)
    columns["success"] = columns["verdict_status"] == Status.OK
    return columns


def counted(parts: Sequence[dict[str, np.ndarray]]) -> GroupTally:
    tally = GroupTally()
    for part in parts:
        selected = part.get("selected", np.ones(len(part["pd"]), bool))
        tally.add(
            *(part["object_id"], part["size_mm"], part["setting"], HANDS),
            *(part["success"], part, selected),
        )
    return tally


def everything(tally: GroupTally) -> str:
    return json.dumps([tally.metrics(), *(tally.groups(by) for by in BY)])


@pytest.mark.parametrize("seed", range(3))
def test_order_and_size_of_batches_change_no_digit(seed):
    columns, rng = made_columns(seed), np.random.default_rng(seed)
    whole = everything(counted([columns]))
    for parts in (1, 2, 13, 200):
        order = np.array_split(rng.permutation(len(columns["pd"])), parts)
        cut = [{name: column[rows] for name, column in columns.items()} for rows in order]
        assert everything(counted(cut)) == whole


@pytest.mark.parametrize("by", BY)
def test_every_group_counts_its_own_rows(by):
    columns = made_columns(7)
    labels = {
        "object": columns["object_id"],
        "size": columns["size_mm"].astype(str),
        "setting": columns["setting"],
        "hand": np.full(len(columns["pd"]), HANDS),
        "status": np.array([Status(s).label for s in columns["verdict_status"]]),
    }[by]
    groups = counted([columns]).groups(by)
    assert set(groups) == set(labels)
    for label, found in groups.items():
        mine = labels == label
        objects = np.unique(columns["object_id"][mine])
        assert (found["rows"], found["objects"]) == (mine.sum(), len(objects))
        for name in ("pd", "drift_pos"):
            values = columns[name][mine]
            mean = found["metrics"][name]
            assert mean["n"] == np.isfinite(values).sum()
            assert mean["mean"] == pytest.approx(np.nanmean(values.astype(float)), rel=1e-12)
        contacts = columns["contact_number"][mine]
        assert found["metrics"]["contact_number"]["n"] == (contacts >= 0).sum()
        assert set(found["metrics"]) == {"pd", "spd", "cdc", "contact_number", "drift_pos"}
        if by == "status":
            assert "selected" not in found
            continue
        of_object = [mine & (columns["object_id"] == o) for o in objects]
        wins = [int((columns["success"] & rows).sum()) for rows in of_object]
        rows = [int(rows.sum()) for rows in of_object]
        assert found["selected"] == clustered_interval(wins, rows).to_dict()


def test_audit_rows_count_per_status_alone_and_what_no_test_saw_in_none():
    columns = made_columns(3)
    selected = columns["verdict_status"] == Status.OK  # as selection has it, nearly
    everything_counted = counted([{**columns, "selected": selected}])
    chosen = counted([{name: column[selected] for name, column in columns.items()}])
    for by in ("object", "size", "setting", "hand"):
        assert everything_counted.groups(by) == chosen.groups(by)
    assert everything_counted.metrics() == chosen.metrics()
    assert everything_counted.groups("status") == counted([columns]).groups("status")
    assert set(chosen.groups("status")) == {"ok"}
    unseen = np.where(selected, columns["verdict_status"], np.int8(Status.NOT_RUN))
    of_all = counted([{**columns, "selected": selected, "verdict_status": unseen}])
    assert of_all.groups("status") == chosen.groups("status")


def test_sizes_stand_in_order_of_size():
    assert list(counted([made_columns(0)]).groups("size")) == ["300", "500", "1000"]


def test_hands_are_named_with_their_sides():
    assert hands_label(Header(tuple(h.header() for h in made_hands()))) == HANDS


def test_nothing_counted_is_nothing_said():
    tally = counted([{name: column[:0] for name, column in made_columns(0).items()}])
    assert tally.metrics() == {}
    assert all(tally.groups(by) == {} for by in BY)


def test_every_number_of_a_verdict_is_a_metric_and_has_a_form():
    states = {"success", "verdict_status", "failed_stage", "direction"}
    assert set(METRICS) == set(columns_written_by("validate")) - states
    assert list(SHOWN) == list(METRICS)
    assert Metrics._fields == MEASURED
    assert AnalyticMetrics._fields == ANALYTIC
    for name, shown in SHOWN.items():
        assert {"m": "mm", "rad": "deg"}.get(FIELDS[name].unit, FIELDS[name].unit) == shown.unit


def test_a_mean_reads_with_its_interval_or_without():
    mean = {"mean": 0.0009, "low": 0.00081, "high": 0.00102}
    assert metric_text("pd", mean) == "0.90 (0.81-1.02)"
    assert metric_text("pd", mean, unit=True) == "0.90 mm (0.81-1.02)"
    assert metric_text("pd", {"mean": 0.0009}) == "0.90"
    assert metric_text("pd", None) == metric_text("pd", {"mean": None}) == "-"


def test_a_release_gives_the_groups_that_its_rows_and_manifest_give(tmp_path):
    made_release(tmp_path / "release", OBJECTS)
    stated = Release.open(tmp_path / "release").figures["tests"]["f"]
    tally = Tally()
    for object_id in reversed(OBJECTS):
        rows = made_rows(object_id)
        tally.add(rows.batch, {"f": rows.verdicts[PAPER_F]}, run="run", grasps=4)
    for by in BY:
        found = describe(tmp_path / "release", by)
        assert found["by"] == by
        assert found["groups"] == {"paper-1": {"f": tally.groups("f", by)}}
        assert stated["groups"].get(by, {}) == (tally.groups("f", by) if by in BOUNDED else {})
    assert stated["metrics"] == tally.figures()["tests"]["f"]["metrics"]
    assert stated["metrics"]["pd"]["method"] == "object bootstrap"


def test_a_release_states_the_figures_of_every_protocol_apart(tmp_path):
    def rows_of(object_id):
        rows = made_rows(object_id)
        swapped = made_verdicts(rows.batch, np.random.default_rng(9))
        return [replace(rows, verdicts={**rows.verdicts, ("mine", "f"): swapped})]

    out = tmp_path / "release"
    made_release(out, OBJECTS, rows_of=rows_of, tests=[PAPER_F, ("mine", "f")])
    for protocol in ("paper-1", "mine"):
        tally = Tally()
        for object_id in OBJECTS:
            (rows,) = rows_of(object_id)
            tally.add(rows.batch, {"f": rows.verdicts[protocol, "f"]}, run="run", grasps=4)
        found = describe(out, "size", protocol)
        assert found["protocol"] == protocol
        assert found["figures"] == tally.figures()
        assert found["groups"] == {protocol: {"f": tally.groups("f", "size")}}
    assert describe(out)["figures"] == describe(out, protocol="paper-1")["figures"]
    assert describe(out, protocol="mine")["figures"]["suc_f"] != describe(out)["figures"]["suc_f"]
    with pytest.raises(UnknownName, match="known: mine, paper-1"):
        describe(out, protocol="other")
    assert verify_release(out).ok

    head = json.loads((out / "manifest.json").read_text())
    older = {k: v for k, v in head.items() if k not in ("files", "other_figures")}
    write_manifest(out, older)
    with pytest.raises(NotUsable, match="figures of paper-1 only"):
        describe(out, protocol="mine")
    head["other_figures"]["mine"]["tests"]["f"]["selected"]["k"] += 1
    write_manifest(out, {k: v for k, v in head.items() if k != "files"})
    assert not verify_release(out).ok


def test_rows_that_were_not_tested_are_in_no_group(tmp_path):
    made_release(tmp_path / "release", OBJECTS[:2], tested=False)
    assert describe(tmp_path / "release", "object")["groups"] == {"paper-1": {"f": {}}}
