"""Laws of the export of motions: which rows are written, the index, and what is refused."""

from __future__ import annotations

import csv
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from made_release import made_release

from bidexdata.cli import main as cli
from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.release import Release
from bidexdata.record import Status
from bidexdata.runs.trajectories import export_trajectories
from bidexdata.runs.trajectory_rig import rig_lines


@pytest.fixture(scope="module")
def armed(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("armed") / "release", arms=True)


@pytest.fixture(scope="module")
def floating(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("floating") / "release")


def selected(path: Path, split: str | None = None):
    release = Release.open(path)
    return release.with_arms(release.grasps(split=split, test="a"))


def index(out: Path) -> list[dict[str, str]]:
    with open(out / "INDEX.csv", newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_selected_row_with_a_motion_is_written_once_and_the_others_are_counted(
    armed, tmp_path
):
    report = export_trajectories(armed, tmp_path / "out", "csv", quiet=True)
    rows = selected(armed)
    moves = rows["arm_status"] == Status.OK
    assert report.rig == "made"
    assert report.grasps == moves.sum() > 0
    assert report.skipped == {"ik_grasp": int((~moves).sum())}
    listed = {row["grasp_id"]: row for row in index(tmp_path / "out")}
    assert sorted(listed) == sorted(rows["grasp_id"][moves].tolist())
    files = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*.csv")}
    assert files == {"INDEX.csv", *(row["files"] for row in listed.values())}
    for n in np.flatnonzero(moves):
        row = listed[str(rows["grasp_id"][n])]
        pose = [row[f"object_quat_{part}"] for part in "wxyz"]
        np.testing.assert_array_equal(np.array(pose, np.float32), rows["object_quat_wxyz"][n])
        assert np.float32(row["object_pos_z"]) == rows["object_pos"][n, 2]
        assert (row["scene_id"], np.float32(row["size"])) == (rows["scene_id"][n], rows["size"][n])
        assert np.float32(row["seconds"]) == rows["arm_time"][n, -1]
    text = (tmp_path / "out" / "README.md").read_text()
    assert "Motions of made" in text
    assert "- left arm: j0, j1, lh_W\n" in text


def test_the_rig_lies_beside_the_motions_and_the_page_says_where_it_stands(armed, tmp_path):
    export_trajectories(armed, tmp_path / "out", "csv", limit=1, quiet=True)
    rig = tmp_path / "out" / "rig.json"
    assert rig.read_bytes() == (armed / "rigs" / "made" / "rig.json").read_bytes()
    arm = {"source": "my_arm.xml", "flange": "tip"}
    spec = {"arm": arm, "left": {"pos": [0, 0.7, 0.2], "quat_wxyz": [0, 0, 0, 1]}}
    spec |= {"right": {"pos": [0, -0.7, 0.2], "quat_wxyz": [1, 0, 0, 0]}}
    spec |= {"mounts": {"*": {"pos": [0.04, 0, 0.12]}, "made": {"top": "forearm"}}}
    said = "\n".join(rig_lines(spec, Release.open(armed).hands))
    assert "left base, my_arm.xml: (0, 0.7, 0.2), (0, 0, 0, 1)" in said
    assert "right hand made: the body `forearm`" in said
    assert said.count("in the frame of the arm's `tip`: (0, 0, 0), (1, 0, 0, 0)") == 2
    del spec["mounts"]["made"]
    said = "\n".join(rig_lines(spec, Release.open(armed).hands))
    assert said.count("its palm frame in the frame of the arm's `tip`: (0.04, 0, 0.12)") == 2


def test_messages_lie_by_arm_and_hand(armed, tmp_path):
    export_trajectories(armed, tmp_path / "out", "ros", limit=2, quiet=True)
    rows = index(tmp_path / "out")
    assert len(rows) == 2
    for row in rows:
        ends = ["left_arm", "right_arm", "left_hand", "right_hand"]
        names = [f"{row['object_id']}/{row['grasp_id']}_{end}.json" for end in ends]
        assert row["files"].split() == names
        for name in names:
            message = json.loads((tmp_path / "out" / name).read_text())
            assert set(message) == {"header", "joint_names", "points"}
            assert all(point["velocities"] == [] for point in message["points"])
    text = (tmp_path / "out" / "README.md").read_text().replace("\n", " ")
    assert "positions and times alone: between such points" in text
    assert "in straight lines" in text


def test_rows_are_chosen_by_split_and_by_what_test_a_said(armed, tmp_path):
    for split in ("train", "test"):
        export_trajectories(armed, tmp_path / split, "csv", split=split, quiet=True)
        rows = selected(armed, split)
        wanted = rows["grasp_id"][rows["arm_status"] == Status.OK].tolist()
        assert sorted(r["grasp_id"] for r in index(tmp_path / split)) == sorted(wanted)
    rows = selected(armed)
    moves = rows["arm_status"] == Status.OK
    for only, passed in (("success", rows["success"]), ("failure", ~rows["success"])):
        export_trajectories(armed, tmp_path / only, "csv", only=only, quiet=True)
        wanted = rows["grasp_id"][moves & passed].tolist()
        assert sorted(r["grasp_id"] for r in index(tmp_path / only)) == sorted(wanted)


def test_a_folder_is_whole_or_not_there(armed, tmp_path, monkeypatch):
    from bidexdata.formats.exporters import trajectories

    def failing(*_):
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(trajectories, "csv_text", failing)
        with pytest.raises(OSError, match="no space"):
            export_trajectories(armed, tmp_path / "out", "csv", quiet=True)
    assert list(tmp_path.iterdir()) == []


def test_what_has_no_arms_says_so_in_one_sentence(floating, armed, tmp_path):
    with pytest.raises(NotUsable, match="has no arm solutions; pack runs that"):
        export_trajectories(floating, tmp_path / "out", "csv", quiet=True)
    with pytest.raises(UnknownName, match=r"'ur10e_post'.*known: made"):
        export_trajectories(armed, tmp_path / "out", "csv", rig="ur10e_post", quiet=True)
    untested = made_release(tmp_path / "untested", arms=True, tested=False, tests=[])
    with pytest.raises(NotUsable, match="no verdicts of test a with arms of made to choose by"):
        export_trajectories(untested, tmp_path / "out", "csv", only="success", quiet=True)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("{armed} --format trajectories-csv --split no", 3, "no split is called 'no'"),
        ("{armed} --format trajectories-csv --only maybe", 3, "success, failure"),
        ("{armed} --format trajectories-csv --limit 0", 2, "limit"),
        ("{armed} --format trajectories-json", 3, "trajectories-csv, trajectories-ros"),
        ("{armed} --rig made", 2, "--rig goes with --format trajectories-csv"),
        ("{armed}/no --format trajectories-ros", 3, "no such file or folder"),
        ("{armed}/objects --format trajectories-ros", 3, "neither a run (run.json) nor a release"),
        ("{floating} --format trajectories-ros", 3, "has no arm solutions"),
    ],
)
def test_bad_input_is_one_sentence_and_an_exit_code(
    words, code, said, armed, floating, tmp_path, capsys
):
    parts = shlex.split(words.format(armed=armed, floating=floating))
    assert cli.run(["export", *parts, "--out", str(tmp_path / "out"), "--quiet"]) == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_wrote(armed, tmp_path, capsys):
    words = ["export", str(armed), "--format", "trajectories-ros", "--out", str(tmp_path / "out")]
    assert cli.run([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["n"] == len(index(tmp_path / "out"))
    assert data["rig"] == "made"
    documented = cli.COMMANDS["export"].__doc__ or ""
    assert all(key in documented for key in data)
    assert cli.run(words) == 3
    assert "is there already" in capsys.readouterr().err
