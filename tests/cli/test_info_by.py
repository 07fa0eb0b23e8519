"""`info --by`: one table row per group, and the same numbers in its JSON."""

import json
import re

import pytest
from made_release import made_release

from bidexdata.cli.groups import group_lines, legend
from bidexdata.cli.main import COMMANDS, run
from bidexdata.formats.groups import BY
from bidexdata.formats.metric_text import BLOCKS
from bidexdata.objects.identity import named_id
from bidexdata.record import Status
from bidexdata.record.fields import METRICS

INLINE = ("--executor", "inline", "--quiet")


@pytest.fixture(scope="module")
def release(tmp_path_factory):
    return made_release(tmp_path_factory.mktemp("by") / "release")


@pytest.mark.parametrize("by", BY)
def test_every_group_has_its_rows_and_means(by, release, capsys):
    assert run(["info", str(release), "--by", by]) == 0
    said = capsys.readouterr().out.splitlines()
    assert run(["info", str(release), "--by", by, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert set(data) <= set(re.findall(r"\w+", COMMANDS["info"].__doc__ or ""))
    groups = data["groups"]["paper-1"]["f"]
    column = "verdict_status" if by == "status" else by
    assert said[1] == f"test f of paper-1, by {column}"
    assert said[-1] == legend(by)
    heads = [i for i, line in enumerate(said) if line.startswith(f"{column} ")]
    assert len(heads) == 3  # nothing was measured that only an option measures
    assert all(heads[i + 1] - heads[i] == len(groups) + 2 for i in range(2))
    assert all(said[at - 1] == "" for at in heads[1:])  # tables stand apart
    name = {"size": "0.30 m", "status": "ok"}.get(by, next(iter(groups)))
    first = said[heads[0] + 1]
    assert first.startswith(f"{name} ")
    shown = groups["ok" if by == "status" else next(iter(groups))]
    pd = shown["metrics"]["pd"]
    assert f"{1000 * pd['mean']:.2f} ({1000 * pd['low']:.2f}-{1000 * pd['high']:.2f})" in first
    assert ("%" in first) == (by != "status")
    assert ("selected and audit" in said[-1]) == (by == "status")


def test_the_lines_of_info_give_the_intervals(release, capsys):
    assert run(["info", str(release)]) == 0
    said = capsys.readouterr().out
    bound = r"\d+\.\d\d"
    means = ", ".join(f"{m} {bound} mm \\({bound}-{bound}\\)" for m in ("PD", "SPD", "CDC"))
    assert re.search(f"means over selected: {means}; D", said)


def test_every_metric_has_a_place_in_one_table():
    assert sorted(m for block in BLOCKS for m in block) == sorted(METRICS)


def test_heads_stand_over_their_columns_however_long_the_object_ids_are():
    longest = named_id("a very long name " * 9, "f" * 64)
    mean = {"n": 1, "objects": 1, "mean": 0.001, "low": None, "high": None, "method": "none"}
    rate = {"k": 1, "n": 1, "rate": 1.0, "low": 0.2, "high": 1.0, "method": "wilson"}
    group = {"rows": 1, "objects": 1, "selected": rate, "metrics": {"pd": mean, "time": mean}}
    groups = {"box-1": group, longest: group}
    lines = group_lines({"by": "object", "groups": {"p": {"f": groups}}})
    for head, column in (("PD mm", "1.00"), ("time s", "0.00")):
        at = next(i for i, line in enumerate(lines) if head in line)
        places = {lines[at].index(head), *(line.index(column) for line in lines[at + 1 : at + 3])}
        assert len(places) == 1


ONE_MEAN = {"n": 2, "objects": 1, "mean": 0.004, "low": 0.003, "high": 0.005, "method": "grasp t"}
"""A mean of anything, in SI units."""


def status_group(rows, **metrics):
    return {"rows": rows, "objects": 1, "metrics": {"pd": ONE_MEAN, **metrics}}


def test_statuses_of_arms_follow_those_of_the_test_and_dashes_are_left_out():
    far = {**ONE_MEAN, "mean": 0.1007, "low": 0.09, "high": 0.11}
    groups = {
        "ok": status_group(2, drift_pos=ONE_MEAN),
        "ik_grasp": status_group(31),
        "not_lifted": status_group(1234, drift_pos=far),
    }
    said = group_lines({"by": "status", "groups": {"p": {"a": groups}}, "rig": "made"})
    assert said[:10] == [
        "test a of p, arms of made, by verdict_status",
        "verdict_status  rows  objects  PD mm",
        "not_lifted      1234        1  4.00 (3.00-5.00)",
        "ok                 2        1  4.00 (3.00-5.00)",
        "ik_grasp          31        1  4.00 (3.00-5.00)",
        "",
        "verdict_status  drift seen mm",  # arms that do not move drop nothing
        "not_lifted      100.7 (90.0-110.0)",
        "ok                4.0 (3.0-5.0)",
        "",
    ]


def test_every_arm_status_is_counted_under_the_name_that_is_stored():
    counts = {"ok": 7, "no_grasp": 120, "ik_grasp": 12}
    some = {"all": counts, "selected": {"ok": 5}, "audit": {"ok": 3, "ik_grasp": 12}}
    arms = {kind: {"by_status": found} for kind, found in some.items()}
    data = {"by": "status", "groups": {}, "rig": "made", "rigs": ["made", "other"], "arms": arms}
    assert group_lines(data) == [
        "arms shown: made (--rig shows others: other)",
        "arms of made, by arm_status",
        "arm_status  rows  selected  audit  what stands against a motion",
        "ok             7         5      3  nothing",
        f"no_grasp     120         0      0  {Status.NO_GRASP.sentence}",
        f"ik_grasp      12         0     12  {Status.IK_GRASP.sentence}",
        "",
        "not validated yet",
    ]
    assert group_lines({**data, "by": "size"}) == ["not validated yet"]


def test_what_cannot_be_grouped_is_said():
    assert group_lines({"by": "size", "groups": {}}) == ["not validated yet"]
    half = {"by": "size", "groups": {"p": {"f": {}}}, "protocols": {"p": {"untested_objects": 2}}}
    assert group_lines(half)[:2] == [
        "test f of p: no object is tested completely yet",
        "objects left out because not all their rows are tested: 2",
    ]


def test_a_grouping_that_is_not_there_is_named(release, capsys):
    assert run(["info", str(release), "--by", "objekt"]) == 3
    assert f"did you mean 'object'?); known: {', '.join(BY)}" in capsys.readouterr().err


def test_a_tabletop_run_says_in_how_many_rest_poses(tmp_path, capsys):
    library, out = str(tmp_path / "library"), str(tmp_path / "run")
    assert run(["prepare", "shapes:box", "--out", library, *INLINE]) == 0
    words = ["--hand", "capsule", "--sizes", "0.3", "--grasps", "1", "--candidates", "1"]
    table = ["--setting", "tabletop", "--rest-poses", "2"]
    run(["synth", library, "--out", out, *words, *table, *INLINE])
    capsys.readouterr()
    assert run(["info", out]) == 0
    assert "tabletop in 2 rest poses, sizes 0.3 m" in capsys.readouterr().out
