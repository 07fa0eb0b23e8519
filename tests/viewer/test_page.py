import contextlib
import dataclasses
import io
import socket
import time

import numpy as np
import pytest
import viser
from picture_samples import Made, grasps

from bidexdata.cli.main import run
from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.pictures.posing import poses_at
from bidexdata.record import GraspBatch
from bidexdata.record.status import Status
from bidexdata.runs.release_rows import RowFilter
from bidexdata.viewer import page as page_module
from bidexdata.viewer.app import serve, serve_source
from bidexdata.viewer.catalog import Catalog, matching_rows
from bidexdata.viewer.filters import ALL_SIZES
from bidexdata.viewer.nodes import body_meshes, split_at_creases
from bidexdata.viewer.page import Page
from bidexdata.viewer.words import scores_markdown, verdict_html


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def server():
    with contextlib.redirect_stdout(io.StringIO()):
        made = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
        yield made
        made.stop()


@pytest.fixture(scope="module")
def source(hands):
    return Made(hands)


@pytest.fixture
def page(server, source):
    """A page whose widgets belong to the server: no browser is needed to change them."""
    server.gui.reset()
    server.scene.reset()
    aimed = []
    made = Page(server.gui, server.scene, Catalog(source), lambda view: aimed.append(view.aim(1.3)))
    made.aimed = aimed
    return made


def drawn_pose(page, side):
    nodes = page.nodes.hands[side]
    return np.array(nodes.base.position), np.array(nodes.base.wxyz)


def test_the_first_page_shows_the_first_grasp_with_its_words(page, source):
    batch = source.batches["box0-00000000"]
    assert page.object.value == "box0-00000000"
    assert page.row == 0
    assert (
        page.count.content == "1 of 5 grasps of this object"
    )  # the failed attempt has no pose to show
    assert Status.SLIP.sentence in page.verdict.content
    assert str(batch["grasp_id"][0]) in page.identity.content
    assert "1.23 mm" in page.scores.content
    assert "CC0-1.0" in page.about.content
    assert page.filters.size.options == (ALL_SIZES, "300 mm", "500 mm")


def test_the_page_tells_what_every_test_said(server, hands):
    class Both(Made):
        tests = ("f", "l")

        def grasps(self, object_id, test=""):
            batch = self.batches[object_id]
            if test != "l":
                return batch
            n = len(batch)
            lifted = {
                "success": np.ones(n, bool),
                "verdict_status": np.full(n, Status.OK, np.int8),
                "drift_pos": np.full(n, 0.004, np.float32),
            }
            ids = np.array([f"9{i:015x}" for i in range(n)])  # rows that came since
            late = GraspBatch(batch.header, {**batch.columns, "grasp_id": ids})
            judged = GraspBatch(batch.header, {**batch.columns, **lifted})
            return GraspBatch.concat([judged, late])

    server.gui.reset()
    server.scene.reset()
    page = Page(server.gui, server.scene, Catalog(Both(hands)), lambda *_: None)
    assert page.row == 0
    assert f"fails test f: {Status.SLIP.sentence}" in page.verdict.content
    assert "passes test l" in page.verdict.content
    assert "drift under load, test l | 4 mm" in page.scores.content
    assert page.scores.content.count("penetration PD") == 1 + page.scores.content.count("SPD")
    assert [len(rows) for rows in page.tested.values()] == [1, 1]


def test_one_handed_grasps_are_shown_beside_their_object(server, hands):
    server.gui.reset()
    server.scene.reset()
    aimed = []
    source = Made(hands[1:])
    page = Page(server.gui, server.scene, Catalog(source), lambda view: aimed.append(view.aim(1.3)))
    batch = source.batches["box0-00000000"]
    assert page.row == 0
    assert len(page.nodes.hands) == 1
    position, target = aimed[-1]
    hand = batch["hand_pos"][0, 0, 1] - batch["object_pos"][0]
    view = position - target
    assert abs(view @ hand) < 0.01 * np.linalg.norm(view) * np.linalg.norm(hand)
    page.step_grasp(1)
    assert page.row == 2  # the next of the same size
    assert "1.23 mm" in page.scores.content


def test_the_stage_slider_hits_the_stored_stages_exactly(page, source):
    batch = source.batches["box0-00000000"]
    for moment, stage in ((0.0, 0), (1.0, 1), (2.0, 2)):
        page.stage.value = moment
        for h in range(2):
            pos, quat = drawn_pose(page, h)
            assert np.array_equal(pos, batch["hand_pos"][0, h, stage].astype(float))
            assert np.array_equal(quat, batch["hand_quat_wxyz"][0, h, stage].astype(float))
    page.stage.value = 0.5
    between = poses_at(batch, 0, 0.5)
    assert np.allclose(drawn_pose(page, 1)[0], between.pos[1])


def test_bodies_stand_where_forward_kinematics_puts_them(page, source, hands):
    page.stage.value = 2.0
    joints = source.batches["box0-00000000"]["joints"][0, 0, 2][: len(hands[0].joint_names)]
    pos, rot = forward_kinematics(hands[0], joints.astype(float))
    assert len(page.nodes.hands[0].bodies) > 10
    for body, frame in page.nodes.hands[0].bodies.items():
        assert np.allclose(frame.position, pos[body], atol=1e-9)
        assert np.allclose(matrix_from_quat(np.array(frame.wxyz)), rot[body], atol=1e-9)


def test_next_and_previous_go_around_through_all_objects(page):
    seen = []
    for _ in range(10):
        seen.append((page.object_id, page.row))
        page.step_grasp(1)
    assert seen == [(o, row) for o in page.catalog.object_ids for row in (0, 2, 4, 1, 3)]
    assert (page.object_id, page.row) == seen[0]
    page.step_grasp(-1)
    assert (page.object_id, page.row) == seen[-1]
    page.step_object(1)
    assert page.object.value == page.object_id == "box0-00000000"
    page.step_object(1)
    assert page.object.value == "box1-00000001"
    assert "box1" in page.about.content


def test_an_object_is_found_by_a_part_of_its_name_or_its_category(page):
    page.filters.text.value = "X1-"
    assert page.found.object_ids == ("box1-00000001",)
    assert page.object.value == page.object_id == "box1-00000001"
    assert page.filters.found.content == "**1** object matches."
    page.step_object(1)
    assert page.object_id == "box1-00000001"
    page.filters.text.value = "crat"
    assert page.object_id == "box0-00000000"
    page.filters.category.value = "beam"
    assert page.found.object_ids == ()
    assert page.row is None
    page.step_object(1)  # harmless
    page.clear_filters()
    assert len(page.found.object_ids) == 2
    assert page.row == 0


def test_a_reason_shows_the_attempts_that_ended_so(page):
    page.filters.reason.value = "slip"
    assert page.rows == [0, 3]
    page.filters.reason.value = "no placement"
    assert page.rows == [5]
    assert "no_placement" in page.verdict.content
    assert not any(nodes.base.visible for nodes in page.nodes.hands)
    assert page.nodes.contacts == []
    page.play()  # harmless


def test_filters_choose_rows_and_say_when_there_are_none(page):
    page.filters.size.value = "500 mm"
    assert page.rows == [1, 3]
    page.filters.outcome.value = "failed"
    assert page.rows == [3]
    assert page.count.content == "1 of 1 grasp of this object"
    assert page.grasp.disabled
    page.filters.kept.value = "audit"
    assert page.rows == []
    assert page.row is None
    assert "No grasp" in page.verdict.content
    assert not any(nodes.base.visible for nodes in page.nodes.hands)
    assert page.nodes.object  # the object stays
    page.step_grasp(1)  # harmless
    page.filters.kept.value, page.filters.outcome.value = "all", "passed"
    assert page.rows == [1]
    assert all(nodes.base.visible for nodes in page.nodes.hands)


def test_the_object_is_sent_again_only_when_it_changes(page):
    page.filters.size.value = "300 mm"
    first = page.nodes.object
    handles = list(first)
    page.step_grasp(1)
    assert page.nodes.object == handles
    page.surface.value = "pieces"
    assert len(page.nodes.object) == 2
    page.surface.value = "mesh"
    assert len(page.nodes.object) == 1


def test_marks_are_shown_as_their_boxes_say(page):
    def visible(nodes):
        return [n.visible for n in nodes]

    assert visible(page.nodes.contacts) == [True, True]
    assert visible(page.nodes.forces) == [False]
    page.forces.value, page.contacts.value = True, False
    page.step_grasp(1)
    assert visible(page.nodes.contacts) == [False, False]
    assert visible(page.nodes.forces) == [True]


def test_the_camera_moves_with_object_and_size_and_not_with_the_grasp(page):
    page.filters.size.value = "300 mm"
    count = len(page.aimed)
    page.step_grasp(1)
    page.stage.value = 2.0
    assert len(page.aimed) == count
    page.filters.size.value = "500 mm"
    assert len(page.aimed) == count + 1
    position, target = page.aimed[-1]
    assert np.linalg.norm(target) < 0.1
    assert np.linalg.norm(position) > 0.5


def test_play_ends_at_the_squeeze_and_stops_when_the_browser_leaves(page, monkeypatch):
    monkeypatch.setattr(page_module, "PLAY_SECONDS", 0.01)
    page.play()
    assert page.stage.value == 2.0
    page.stage.value = 1.0
    page.close()
    page.play()
    assert page.stage.value == 1.0


def test_two_pages_of_one_catalog_do_not_turn_each_other(page, source):
    with contextlib.redirect_stdout(io.StringIO()):
        other = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
        two = Page(other.gui, other.scene, page.catalog, lambda *_: None)
        page.step_grasp(2)
        page.filters.outcome.value = "failed"
        page.step_object(1)
        assert two.row == 0
        assert two.filters.outcome.value == "all"
        assert two.object.value == "box0-00000000"
        other.stop()


def test_a_page_of_a_library_has_objects_and_no_hands(server, source):
    class Bare(Made):
        kind = "library"
        test = ""

        def grasps(self, object_id):
            return None

        def hands(self):
            return ()

    server.gui.reset()
    server.scene.reset()
    page = Page(server.gui, server.scene, Catalog(Bare(source.hands())), lambda *_: None)
    assert page.row is None
    assert page.nodes.hands == []
    assert len(page.nodes.object) == 2  # its pieces
    page.step_object(1)
    assert "box1" in page.about.content


def test_the_server_listens_here_only_and_closes_cleanly(source):
    import urllib.request

    port = free_port()
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        server = serve_source(source, port=port)
        try:
            assert server.get_host() == "127.0.0.1"
            answer = urllib.request.urlopen(f"http://127.0.0.1:{server.get_port()}", timeout=20)
            assert answer.status == 200
            assert b"<html" in answer.read().lower()
        finally:
            server.stop()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                break
        time.sleep(0.1)
    else:
        pytest.fail("the port is still open")


def test_a_taken_port_is_said_and_the_address_is_that_of_the_server(source, monkeypatch, capsys):
    monkeypatch.setattr("bidexdata.viewer.app.open_browsable", lambda path, protocol, rig: source)
    monkeypatch.setattr("bidexdata.viewer.app.wait_until_interrupted", lambda s: s.stop())
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert run(["view", "release", "--port", str(port)]) == 0
    out, err = capsys.readouterr()
    used = int(err.rsplit(maxsplit=1)[-1])
    assert used != port
    assert err.strip() == f"port {port} is taken; using {used}"
    assert f"open http://127.0.0.1:{used} in a browser" in out


def test_what_cannot_be_shown_is_named(tmp_path):
    with pytest.raises(PathNotFound, match="a library, a run or a release"):
        serve(tmp_path / "missing", block=False)
    with pytest.raises(NotUsable, match="neither a library"):
        serve(tmp_path, block=False)


def test_an_address_of_another_machine_is_refused_at_once(source):
    with pytest.raises(NotUsable, match=r"--host '192\.0\.2\.1' is no address of this machine"):
        serve_source(source, host="192.0.2.1")


def test_rows_are_found_by_size_outcome_and_kind(hands, source):
    batch = source.batches["box0-00000000"]

    def rows(batch, **wanted):
        return matching_rows({"f": batch}, RowFilter(**wanted))

    assert matching_rows({}, RowFilter()) == []
    assert rows(batch) == [0, 2, 4, 1, 3]  # by size, then as stored
    assert rows(batch, size_mm=300) == [0, 2, 4]
    assert rows(batch, outcome="passed") == [2, 4, 1]
    assert rows(batch, kept="audit") == [0, 2, 4]
    assert rows(batch, reason=Status.SLIP) == [0, 3]
    assert rows(batch, reason=Status.NO_PLACEMENT) == [5]
    names = {k: v for k, v in batch.columns.items() if k != "verdict_status"}
    untested = dataclasses.replace(batch, columns=names)
    assert len(rows(untested, outcome="not tested")) == 5
    assert rows(untested, reason=Status.SLIP) == []
    assert rows(grasps(hands, source.solids["box0-00000000"], 1)) == []


def test_words_are_escaped_and_missing_numbers_left_out(source):
    batch = source.batches["box0-00000000"]
    assert "<script" not in verdict_html({"<script>": batch}, 0)
    table = scores_markdown({"f": batch}, 0)
    assert "PD" in table
    assert "load margin" not in table  # not measured


def test_sharp_edges_get_vertices_of_their_own_and_nothing_moves(hands):
    from bidexdata.pictures.drawing import solid_parts

    box = solid_parts(Made(hands).solids["box0-00000000"], 0.4)[0]
    vertices, faces = split_at_creases(box)
    assert len(vertices) == 24  # three for each corner
    assert np.allclose(vertices[faces], box.vertices[box.faces], atol=1e-6)
    for _, body_vertices, body_faces in body_meshes(hands[0]):
        assert body_faces.max() < len(body_vertices)
