"""A release with arms is judged again by tests without arms, whose rows have no arm columns."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_release import PER_SCENE, made_release

from bidexdata.cli.main import run as bidexdata
from bidexdata.errors import NotUsable
from bidexdata.formats.release import Release
from bidexdata.hands import load_hands
from bidexdata.runs.resimulate import resimulate
from bidexdata.validation import load_protocol, validate_grasps
from bidexdata.validation.validate import grasp_of

BOX = "box-aaaaaaaa"


@pytest.fixture(scope="module")
def armed(tmp_path_factory) -> Path:
    return made_release(
        tmp_path_factory.mktemp("armed") / "release",
        (BOX,),
        arms=True,
        hands=load_hands("capsule"),
        sizes=(300,),
    )


def test_verify_judges_its_rows_again(armed: Path):
    release = Release.open(armed)
    rows = release.grasps(BOX, test="f")
    assert release.rig
    assert "arm_status" not in rows
    judged = resimulate(release, rows, release.load_solid(BOX), "f")
    assert judged.success.shape == (PER_SCENE,)


def test_a_motion_is_read_where_arms_are_joined(armed: Path):
    release = Release.open(armed)
    rows = release.grasps(BOX)
    assert grasp_of(rows, 0).motion is None
    assert grasp_of(release.with_arms(rows), 0).motion is not None


def test_test_a_of_rows_without_their_arms_is_refused(armed: Path):
    release = Release.open(armed)
    with pytest.raises(NotUsable, match="needs the arms' motions"):
        validate_grasps(
            *(release.grasps(BOX), release.load_solid(BOX), load_hands("capsule")),
            *(load_protocol("paper-1"), "a"),
        )


def test_validate_judges_a_run_of_its_rows(armed: Path, tmp_path: Path, capsys):
    words = ["validate", str(armed), "--out", str(tmp_path / "run"), "--tests", "f"]
    code = bidexdata([*words, "--executor", "inline"])
    said = capsys.readouterr()
    assert "failed" not in said.err
    assert f"of {2 * PER_SCENE - 1} rows passed" in said.out
    assert code in (0, 6)  # random poses need not hold


def test_a_validation_that_fails_in_every_task_is_told(
    armed: Path, tmp_path: Path, capsys, monkeypatch
):
    from bidexdata.validation import validate

    def broken(*_, **__):
        raise RuntimeError("broken")

    monkeypatch.setattr(validate, "validate_grasps", broken)
    out = tmp_path / "run"
    words = ["validate", str(armed), "--out", str(out), "--tests", "f", "--executor", "inline"]
    assert bidexdata(words) == 6
    said = capsys.readouterr()
    assert f"{out}: every task failed; {out}/logs says why" in said.err
    assert "next: bidexdata pack" not in said.out
    assert bidexdata(["info", str(out)]) == 0
    assert "validation by paper-1 was started and no task has a verdict" in capsys.readouterr().out


def test_what_has_no_meshes_is_not_to_be_viewed_next(tmp_path: Path, capsys):
    named = made_release(tmp_path / "named", (BOX,), licences="ids-only")
    assert bidexdata(["verify", str(named)]) == 0
    assert f"next: bidexdata info {named}" in capsys.readouterr().out
