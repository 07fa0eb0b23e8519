"""The page of grasps with arms: they move with the time slider, and rows without look as ever."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import viser
from armed_source import FAILED, Armed, armed_source
from picture_samples import Made

from bidexdata.arms.motion import hand_poses, motion_of
from bidexdata.arms.robot_shapes import body_places
from bidexdata.errors import NotUsable
from bidexdata.frames import matrix_from_quat
from bidexdata.record import Status
from bidexdata.viewer import export
from bidexdata.viewer import page as page_module
from bidexdata.viewer.catalog import Catalog
from bidexdata.viewer.page import Page
from bidexdata.viewer.server import free_port


@pytest.fixture(scope="module")
def source(hands, tmp_path_factory):
    return armed_source(hands, tmp_path_factory.mktemp("rig"))


@pytest.fixture(scope="module")
def server():
    with contextlib.redirect_stdout(io.StringIO()):
        made = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
        yield made
        made.stop()


def page_of(server, source):
    server.gui.reset()
    server.scene.reset()
    aimed = []
    page = Page(server.gui, server.scene, Catalog(source), lambda view: aimed.append(view.aim(1.3)))
    page.aimed = aimed
    return page


@pytest.fixture
def page(server, source):
    return page_of(server, source)


def motion_shown(source, page):
    rows = source.arms(page.object_id)
    return motion_of(source.robot(), rows, page.row)


def test_the_slider_moves_arms_hands_and_object(page, source):
    motion = motion_shown(source, page)
    assert (page.motion.time.visible, page.stage.visible) == (True, False)
    assert page.motion.time.max == pytest.approx(motion.seconds)
    pos = np.array(page.nodes.object[0].position)
    for time in (0.0, 1.234, motion.seconds):
        page.motion.time.value = time
        moment = motion.at(page.motion.time.value)
        wanted = hand_poses(motion.robot, moment)
        for h, nodes in enumerate(page.nodes.hands):
            assert np.allclose(nodes.base.position, wanted.pos[h])
            places = body_places(motion.robot, h, moment.arms[h], moment.joints[h])
            for number, node in page.arm_nodes.bodies[h].items():
                assert np.allclose(node.position, places.pos[number])
                turned = matrix_from_quat(np.array(node.wxyz))
                assert np.allclose(turned, places.rot[number], atol=1e-6)
        rise = moment.object_pos - motion.object_pos[0]
        assert np.allclose(page.nodes.object[0].position, pos + rise)
        assert np.allclose(page.nodes.marks.position, rise)


def test_keys_of_the_stages_go_to_their_times_and_play_goes_through_all(page, source, monkeypatch):
    motion = motion_shown(source, page)
    assert page.motion.time.value == pytest.approx(motion.key_time[3])  # the grasp at first
    for stage in range(3):
        page.set_stage(float(stage))
        assert page.motion.time.value == pytest.approx(motion.key_time[2 + stage])
    monkeypatch.setattr(page_module, "MOTION_SPEED", 100.0)
    page.play()
    assert page.motion.time.value == pytest.approx(motion.seconds)
    page.step_grasp(3)  # to another that takes longer: still at the lift
    assert page.motion.time.value == pytest.approx(motion_shown(source, page).seconds)
    page.close()
    page.set_time(0.0)
    page.play()
    assert page.motion.time.value == 0.0


def test_rows_without_a_motion_and_pages_without_arms_look_as_ever(page, source, hands, server):
    page.motion.time.value = page.motion.time.max
    count = len(page.aimed)
    page.step_grasp(1)
    assert page.row == FAILED
    bare = page_of(server, Made(hands))
    bare.step_grasp(1)
    assert bare.row == FAILED
    for one in (page, bare):
        assert (one.motion.time.visible, one.stage.visible) == (False, True)
        for ours, theirs in zip(one.nodes.hands, bare.nodes.hands, strict=True):
            assert np.array_equal(ours.base.position, theirs.base.position)
    assert not page.arm_nodes.base.visible
    assert bare.arm_nodes is None
    assert not bare.motion.arms.visible
    assert bare.arm_words.content == ""
    assert len(page.aimed) == count + 1  # nearer: there are no arms to see
    assert np.allclose(page.aimed[-1], bare.aimed[-1])
    assert f"jump: {Status.JUMP.sentence}" in page.arm_words.content


def test_the_box_hides_arms_and_shows_them_again(page):
    assert page.arm_nodes.base.visible
    far = page.aimed[-1]
    page.motion.time.value = page.motion.time.max
    page.motion.arms.value = False
    assert not page.arm_nodes.base.visible
    assert (page.motion.time.visible, page.stage.visible) == (False, True)
    assert np.allclose(page.nodes.marks.position, 0)
    page.motion.arms.value = True
    assert page.arm_nodes.base.visible
    assert page.motion.time.value == page.motion.time.max
    assert np.allclose(page.aimed[-1], far)
    assert np.linalg.norm(np.subtract(*far)) > 2.0


def test_words_say_what_the_arms_do_and_why_they_cannot_be_shown(server, source, page):
    assert "made takes it in 2.9 s" in page.arm_words.content
    assert "the table by 12 mm" in page.arm_words.content

    class Elsewhere(Armed):
        def robot(self):
            raise NotUsable("no such rig here")

    other = page_of(server, _moved(source, Elsewhere))
    assert "not shown: no such rig here" in other.arm_words.content
    assert other.stage.visible
    assert other.arm_nodes is None


def _moved(source, kind):
    made = kind(source.hands(), None)
    arms = {name: source.arms(name) for name in source.object_ids}
    made.arms = arms.get
    return made


def test_an_exported_grasp_moves_with_its_arms(source, tmp_path, monkeypatch):
    monkeypatch.setattr(export, "open_browsable", lambda path, protocol, rig: source)
    monkeypatch.setattr(export, "MOTION_STEP", 1.0)
    monkeypatch.setattr(export, "STEPS", 3)
    wanted = str(source.batches["box0-00000000"]["grasp_id"][0])
    made = export.export_grasp("run", wanted, tmp_path / "a.html")
    text = made.out.read_text()
    assert "made takes it in 2.9 s" in text
    monkeypatch.setattr(type(source), "rig", "")
    bare = export.export_grasp("run", wanted, tmp_path / "b.html")
    assert bare.bytes < made.bytes
    assert "takes it" not in bare.out.read_text()
