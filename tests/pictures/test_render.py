"""Choosing and drawing rows; the file formats behind `open_browsable` have their own tests."""

import sys
from pathlib import Path

import numpy as np
import pytest
from picture_samples import Made
from PIL import Image

from bidexdata.errors import BadConfig, MissingExtra, NotUsable, PathNotFound, UnknownName
from bidexdata.record.status import Status
from bidexdata.runs import render as render_module
from bidexdata.runs.browse import open_browsable, verdicts_of
from bidexdata.runs.choose import choose_grasps, chosen_of_each
from bidexdata.runs.render import render


@pytest.fixture(scope="module")
def source(hands):
    return Made(hands, 12)


@pytest.fixture
def opened(source, monkeypatch):
    """Let `render` find the hand-made rows under any path."""
    monkeypatch.setattr(
        render_module, "open_browsable", lambda path, protocol=None, rig=None: source
    )
    monkeypatch.setattr(render_module, "WIDTH", 60)
    monkeypatch.setattr(render_module, "HEIGHT", 48)


def keys(chosen):
    return [(s.object_id, str(s.batch["grasp_id"][s.row])) for s in chosen]


@pytest.mark.parametrize("count", [1, 2, 5, 9, 100])
@pytest.mark.parametrize("only", [None, "success", "failure"])
def test_chosen_grasps_are_different_spread_and_what_was_asked_for(source, count, only):
    chosen = choose_grasps(source, count, only=only)
    assert len(set(keys(chosen))) == len(chosen) <= count
    assert keys(chosen) == keys(choose_grasps(source, count, only=only))
    for s in chosen:
        assert str(s.batch["object_id"][s.row]) == s.object_id
        assert np.isfinite(s.batch["hand_pos"][s.row]).all()
        if only:
            assert verdicts_of(s.batch)[s.row] == (only == "success")
    per_object = [sum(s.object_id == o for s in chosen) for o in source.object_ids]
    assert max(per_object) - min(per_object) <= 1
    if count == 5 and only is None:
        assert {int(s.batch["size_mm"][s.row]) for s in chosen} == {300, 500}


def test_statuses_that_no_grasp_came_to_leave_their_places_to_the_others(source):
    both = [Status.SLIP, Status.NO_PLACEMENT]  # without a pose
    slips = len(choose_grasps(source, 99, status=Status.SLIP))
    count = min(4, 2 * (slips // 2))
    assert count >= 2
    chosen = chosen_of_each(source, count, None, both, 0, moving=False)
    assert len(chosen) == count
    assert len(chosen_of_each(source, count, None, both[:1], 0, moving=False)) == count


def test_grasps_are_chosen_by_what_became_of_them(source, opened, tmp_path: Path):
    chosen = choose_grasps(source, 9, status=Status.SLIP)
    assert chosen
    assert {int(s.batch["verdict_status"][s.row]) for s in chosen} == {Status.SLIP}
    assert choose_grasps(source, 9, status=Status.NO_PLACEMENT) == []  # without a pose
    report = render("run", tmp_path / "a.png", status=["slip"], count=1, views=1, quiet=True)
    assert len(report.shown) == 1
    with pytest.raises(UnknownName, match=r"no status is called 'slipp' \(did you mean 'slip'"):
        render("run", tmp_path / "b.png", status=["slipp"], quiet=True)
    with pytest.raises(NotUsable, match=r"--status jump chooses nothing; run: bidexdata arms made"):
        render("run", tmp_path / "b.png", status=["jump"], quiet=True)
    with pytest.raises(NotUsable, match="--arms draws nothing"):
        render("run", tmp_path / "b.png", arms=True, quiet=True)


def test_another_seed_chooses_other_grasps(source):
    assert keys(choose_grasps(source, 4)) != keys(choose_grasps(source, 4, seed=1))


def test_one_handed_grasps_get_a_sheet_that_names_their_hand(hands, monkeypatch, tmp_path: Path):
    made = Made(hands[1:], 3)
    monkeypatch.setattr(render_module, "open_browsable", lambda path, protocol=None, rig=None: made)
    report = render("run", tmp_path / "a.png", count=2, quiet=True)
    assert len(report.shown) == 2
    assert render_module.sheet_title(made, None, ["right"]).endswith("right hand green")
    assert Image.open(tmp_path / "a.png").size[0] > 2 * render_module.WIDTH


def test_a_sheet_is_written_and_the_same_twice(opened, tmp_path: Path):
    first = render("run", tmp_path / "a.png", count=2, quiet=True)
    second = render("run", tmp_path / "deeper" / "b.png", count=2, quiet=True)
    assert first.shown == second.shown
    assert (tmp_path / "a.png").read_bytes() == second.out.read_bytes()
    assert "Warp" in first.drawn_by
    assert "cpu" in first.drawn_by
    with Image.open(tmp_path / "a.png") as sheet:
        assert sheet.size[0] >= 2 * 60 + 4
        assert len(np.unique(np.asarray(sheet).reshape(-1, 3), axis=0)) > 100


def test_a_video_moves_and_rests_at_its_ends(opened, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(render_module, "VIDEO_MOMENTS", (0.0, 1.0, 2.0))
    report = render("run", tmp_path / "a.gif", count=1, video=True, quiet=True)
    assert len(report.shown) == 1
    with Image.open(tmp_path / "a.gif") as movie:
        assert movie.n_frames == 3


def test_a_video_may_be_an_mp4(opened, tmp_path: Path, monkeypatch):
    import av

    monkeypatch.setattr(render_module, "VIDEO_MOMENTS", (0.0, 1.0, 2.0))
    render("run", tmp_path / "a.mp4", count=2, video=True, quiet=True)
    with av.open(str(tmp_path / "a.mp4")) as movie:
        frames = [f.to_ndarray(format="rgb24") for f in movie.decode(video=0)]
    assert len(frames) == 3
    assert np.abs(frames[0].astype(int) - frames[2]).max() > 50
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtra, match="pip install"):
        render("run", tmp_path / "b.mp4", count=2, video=True, quiet=True)
    assert not (tmp_path / "b.mp4").exists()


def test_video_moments_run_through_all_stages():
    moments = render_module.VIDEO_MOMENTS
    assert list(moments) == sorted(moments)
    assert {0.0, 1.0, 2.0} <= set(moments)


def test_impossible_wishes_are_named(opened, source, tmp_path: Path, monkeypatch):
    for ending in ("mp4", "jpgg"):
        with pytest.raises(BadConfig, match="contact sheet") as caught:
            render("run", tmp_path / f"a.{ending}", quiet=True)
        assert caught.value.exit_code == 3  # as every output file of an unknown ending
    with pytest.raises(BadConfig, match="animation"):
        render("run", tmp_path / "a.jpg", video=True, quiet=True)
    with pytest.raises(BadConfig, match="--count"):
        render("run", tmp_path / "a.png", count=0, quiet=True)
    monkeypatch.setattr(source, "test", "")
    with pytest.raises(NotUsable, match="bidexdata validate"):
        render("run", tmp_path / "a.png", only="success", quiet=True)
    assert not list(tmp_path.iterdir())


def test_a_path_without_data_is_named(tmp_path: Path):
    with pytest.raises(PathNotFound):
        open_browsable(tmp_path / "nothing")
    with pytest.raises(NotUsable, match="neither"):
        open_browsable(tmp_path)
