"""One page: its widgets, what they mean, and what happens when one changes.

Every browser gets a page of its own, so two people do not turn each other's pages.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.pictures.drawing import Surface
from bidexdata.pictures.posing import has_pose, poses_at
from bidexdata.record import GraspBatch
from bidexdata.runs.release_rows import RowFilter
from bidexdata.viewer.catalog import Catalog, Found
from bidexdata.viewer.filters import FilterWidgets
from bidexdata.viewer.motion_panel import MotionPanel
from bidexdata.viewer.nodes import GraspNodes
from bidexdata.viewer.view import View, view_of_grasp, view_of_motion
from bidexdata.viewer.words import (
    arms_markdown,
    found_markdown,
    identity_markdown,
    object_markdown,
    scores_markdown,
    verdict_html,
)
from bidexdata.wording import counted

if TYPE_CHECKING:
    import viser

    from bidexdata.viewer.arm_nodes import ArmNodes

NO_MATCH = "No grasp matches the filters."
LISTED = 50
"""Objects that the drop-down offers; the others are found by the text box."""
LIBRARY_SIZE = 0.4
"""Diagonal at which a library's objects are shown [m]."""
STAGE_MARKS = ((0.0, "pre-grasp"), (1.0, "grasp"), (2.0, "squeeze"))
PLAY_SECONDS = 2.5
_PLAY_STEPS = 50
MOTION_SPEED = 1.0
"""Seconds of a motion of arms that play in one [-]."""
_TICK = 0.04
"""Between two pictures of it [s]."""
KEYS = (
    "**N** / **P** next / previous grasp · **O** / **shift O** next / previous object · "
    "**1** **2** **3** stages · **space** play"
)


class Page:
    """Widgets and scene of one browser.

    Args:
        gui: Where widgets go: a client's, or a server's for all clients.
        scene: Where nodes go.
        catalog: What is shown.
        look: Has a view in the picture of the camera.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        scene: viser.SceneApi,
        catalog: Catalog,
        look: Callable[[View], None],
    ):
        self._gui, self.catalog, self._look = gui, catalog, look
        self._lock = threading.RLock()
        self._setting = False  # a widget is being set from here, not by the person
        self._playing = self._closed = False
        self._aimed_at: tuple[str, float, bool] | None = None
        self._applied: RowFilter | None = None
        self.found = Found((), None, lambda _: [])
        self.object_id = ""
        self.rows: list[int] = []
        self.tested: dict[str, GraspBatch] = {}
        self.batch: GraspBatch | None = None
        self._has_grasps = catalog.source.kind != "library"
        self._build_widgets()
        self._build_keys()
        self.nodes = GraspNodes(scene, catalog.hands)
        self._scene = scene
        self.arm_nodes: ArmNodes | None = None  # sent when there is something to see
        self.apply_filters()

    @property
    def row(self) -> int | None:
        """Number of the row that is shown; None when no row matches the filters."""
        return self.rows[int(self.grasp.value) - 1] if self.rows else None

    def apply_filters(self) -> None:
        """Find what matches the widgets and show the first grasp, of this object if it has one."""
        with self._lock:
            wanted = self.filters.wanted()
            if wanted == self._applied:  # a person types faster than rows are found
                return
            self._applied, self.found = wanted, self.catalog.find(wanted)
            self.filters.found.content = found_markdown(self.found)
            ids = self.found.object_ids
            self.open_object(self.object_id if self.object_id in ids or not ids else ids[0])

    def open_object(self, object_id: str = "", *, last: bool = False) -> None:
        """Show the first grasp (or the last) of an object that matches the filters.

        Args:
            object_id: Which; the first of all when empty.
            last: Show the last.
        """
        with self._lock:
            self.object_id = object_id or self.catalog.object_ids[0]
            self._list_objects()
            self.solid = self.catalog.solid(self.object_id)
            self.about.content = object_markdown(self.solid)
            self.filters.offer_sizes(self.catalog.sizes_mm(self.object_id), self._set)
            matches = self.object_id in self.found.object_ids
            self.rows = self.found.rows_of(self.object_id) if matches else []
            count = len(self.rows)
            self._set(self.grasp, max=max(count, 2), disabled=count < 2)
            self._set(self.grasp, value=max(count, 1) if last else 1)
            self.show_grasp()

    def show_grasp(self) -> None:
        """Read and show the chosen row: object at its pose, contacts, words, hands at the stage."""
        with self._lock:
            row = self.row
            self.tested = {} if row is None else self.catalog.grasp(self.object_id, row)
            self.batch = next(iter(self.tested.values()), None)
            self._show_object(self.batch)
            self._offer_motion()
            if self.batch is None:
                self.nodes.clear_contacts()
                self.verdict.content = NO_MATCH if self._has_grasps else ""
                self.identity.content = self.scores.content = ""
            else:
                self._show_contacts(self.batch)
                self.verdict.content = verdict_html(self.tested, 0)
                self.identity.content = identity_markdown(self.batch, 0)
                self.scores.content = scores_markdown(self.tested, 0)
            self._say_count()
            self.show_marks()
            self.show_arms()

    def show_stage(self) -> None:
        """Move the hands to the stage slider's moment, or with arms to the time slider's."""
        with self._lock:
            if self.motion.shown:
                self._show_motion(float(self.motion.time.value))
            elif self.batch is None or not has_pose(self.batch, 0):
                self.nodes.pose(None)
            else:
                self.nodes.pose(poses_at(self.batch, 0, float(self.stage.value)))

    def show_arms(self) -> None:
        """Show or hide the arms as their box says."""
        with self._lock:
            shown = self.motion.shown
            self.motion.show()
            self.stage.visible = not shown
            if self.arm_nodes is not None:
                self.arm_nodes.show(shown)
            if not shown:
                self.nodes.raise_object(np.zeros(3))
            self.show_stage()
            self._aim_camera()

    def show_marks(self) -> None:
        """Show or hide contacts and forces as their boxes say."""
        self.nodes.set_visible(contacts=self.contacts.value, forces=self.forces.value)

    def step_grasp(self, by: int) -> None:
        """Go to the next (1) or previous (-1) grasp, past an object's last to the next object."""
        with self._lock:
            at = int(self.grasp.value) - 1 + by
            if not 0 <= at < len(self.rows) and len(self.found.object_ids) > 1:
                self.step_object(1 if by > 0 else -1, last=by < 0)
            elif self.rows:
                self._set(self.grasp, value=at % len(self.rows) + 1)
                self.show_grasp()

    def step_object(self, by: int, *, last: bool = False) -> None:
        """Go to the next (1) or previous (-1) object that matches; `last`: to its last grasp."""
        with self._lock:
            ids = self.found.object_ids
            if ids:
                at = ids.index(self.object_id) + by if self.object_id in ids else 0
                self.open_object(ids[at % len(ids)], last=last)

    def clear_filters(self) -> None:
        """Let every grasp through again."""
        with self._lock:
            self.filters.reset(self._set)
            self.apply_filters()

    def set_stage(self, moment: float) -> None:
        """Put the stage slider somewhere; with arms the time slider to when they are there."""
        if self.motion.shown:
            self.set_time(self.motion.time_of_stage(moment))
            return
        self._set(self.stage, value=moment)
        self.show_stage()

    def set_time(self, time: float) -> None:
        """Put the time slider somewhere [s]."""
        with self._lock:
            self._set(self.motion.time, value=time)
            self.show_stage()

    def play(self) -> None:
        """Move from pre-grasp to squeeze, with arms from home to the lift.

        A second press while it moves does nothing.
        """
        with self._lock:
            if self._playing or self.batch is None or not has_pose(self.batch, 0):
                return
            self._playing = True
        try:
            if self.motion.shown:
                self._play_motion()
                return
            for moment in np.linspace(0, 2, _PLAY_STEPS):
                if self._closed:
                    break
                self.set_stage(round(float(moment), 2))
                time.sleep(PLAY_SECONDS / _PLAY_STEPS)
        finally:
            self._playing = False

    def _play_motion(self) -> None:
        """Play the motion at its own speed, as many pictures of it as there is time for."""
        motion, began = self.motion.motion, time.monotonic()
        assert motion is not None
        at = 0.0
        while self.motion.motion is motion and self.motion.shown and not self._closed:
            self.set_time(at)
            if at >= motion.seconds:
                break
            time.sleep(_TICK)
            at = min(MOTION_SPEED * (time.monotonic() - began), motion.seconds)

    def close(self) -> None:
        """End what still moves: the browser is gone."""
        self._closed = True

    def _build_widgets(self) -> None:
        gui, shown = self._gui, self._has_grasps
        self.filters = FilterWidgets(gui, self.catalog)
        with gui.add_folder("Object"):
            self.object = gui.add_dropdown("object", self.catalog.object_ids[:1])
            objects = gui.add_button_group("turn to", ("previous object", "next object"))
            self.surface = gui.add_dropdown(
                "shape",
                ("mesh", "pieces"),
                initial_value="mesh" if shown else "pieces",
                hint="repaired mesh, or the convex pieces that are simulated",
            )
            self.about = gui.add_markdown("")
        grasp_folder = gui.add_folder("Grasp", visible=shown)
        with grasp_folder:
            self.count = gui.add_markdown("")
            self.grasp = gui.add_slider("grasp", 1, 2, 1, 1)
            grasps = gui.add_button_group("go to", ("previous", "next"))
            self.stage = gui.add_slider("stage", 0.0, 2.0, 0.02, 1.0, marks=STAGE_MARKS)
            self.motion = MotionPanel(
                *(gui, grasp_folder, self.catalog.source.rig),
                toggled=self.show_arms,
                moved=self.show_stage,
                watch=self._on_update,
            )
            play = gui.add_button("play", hint="pre-grasp to squeeze; arms from home to the lift")
            self.contacts = gui.add_checkbox("contacts and normals", True)
            self.forces = gui.add_checkbox("forces", False, hint="of the zero-load QP, orange")
        with gui.add_folder("Verdict and scores", visible=shown):
            self.verdict = gui.add_html("")
            self.identity = gui.add_markdown("")
            self.arm_words = gui.add_markdown("")
            self.scores = gui.add_markdown("")
        with gui.add_folder("Keys", expand_by_default=False):
            gui.add_markdown(KEYS if shown else "**O** / **shift O** next / previous object")

        self._on_update(self.object, lambda: self.open_object(str(self.object.value)))
        for widget in self.filters.all:
            self._on_update(widget, self.apply_filters)
        self.filters.clear.on_click(lambda _: self.clear_filters())
        for widget in (self.grasp, self.surface):
            self._on_update(widget, self.show_grasp)
        self._on_update(self.stage, self.show_stage)
        for widget in (self.contacts, self.forces):
            self._on_update(widget, self.show_marks)
        objects.on_click(lambda _: self.step_object(_direction(objects.value)))
        grasps.on_click(lambda _: self.step_grasp(_direction(grasps.value)))
        play.on_click(lambda _: self.play())

    def _build_keys(self) -> None:
        gui = self._gui

        def key(label: str, hotkey: Any, act: Callable[[], None], modifier: Any = None) -> None:
            command = gui.add_command(label, hotkey=hotkey, modifier=modifier)
            command.on_trigger(lambda _: act())

        key("Next object", "O", lambda: self.step_object(1))
        key("Previous object", "O", lambda: self.step_object(-1), "shift")
        if self._has_grasps:
            key("Next grasp", "N", lambda: self.step_grasp(1))
            key("Previous grasp", "P", lambda: self.step_grasp(-1))
            for number, (moment, label) in enumerate(STAGE_MARKS, start=1):
                key(f"Stage: {label}", str(number), lambda at=moment: self.set_stage(at))
            key("Play the stages", "space", self.play)

    def _on_update(self, widget: Any, act: Callable[[], None]) -> None:
        def changed(_: Any) -> None:
            # Setting a widget from here calls back at once, in the same thread.
            if not self._setting:
                act()

        widget.on_update(changed)

    def _set(self, widget: Any, **values: Any) -> None:
        with self._lock:
            self._setting = True
            try:
                for name, value in values.items():
                    setattr(widget, name, value)
            finally:
                self._setting = False

    def _list_objects(self) -> None:
        """Offer the objects around this one that match the filters."""
        ids = self.found.object_ids
        at = ids.index(self.object_id) if self.object_id in ids else 0
        first = max(min(at - LISTED // 2, len(ids) - LISTED), 0)
        listed = ids[first : first + LISTED]
        if self.object_id not in listed:
            listed = (self.object_id, *listed)
        if tuple(self.object.options) != listed:
            self._set(self.object, options=listed)
        self._set(self.object, value=self.object_id)

    def _say_count(self) -> None:
        total = len(self.rows)
        at = int(self.grasp.value) if total else 0
        self.count.content = f"{at:,} of {counted(total, 'grasp')} of this object"

    def _offer_motion(self) -> None:
        """Read what the arms have for the row, say it, and send them where there is a motion."""
        batch = None if self.batch is None else self.catalog.armed(self.object_id, self.batch)
        robot = None if batch is None else self.catalog.robot
        motion = None
        if batch is not None and robot is not None:
            from bidexdata.arms.motion import motion_of

            motion = motion_of(robot, batch, 0)
        self.arm_words.content = arms_markdown(batch, 0, self.catalog.no_robot)
        if motion is not None and self.arm_nodes is None:
            from bidexdata.viewer.arm_nodes import ArmNodes

            self.arm_nodes = ArmNodes(self._scene, motion.robot)
        self.motion.offer(motion)

    def _show_motion(self, at: float) -> None:
        from bidexdata.arms.motion import hand_poses

        motion = self.motion.motion
        assert motion is not None
        assert self.arm_nodes is not None
        moment = motion.at(at)
        self.arm_nodes.move(moment)
        self.nodes.pose(hand_poses(motion.robot, moment))
        self.nodes.raise_object(moment.object_pos - motion.object_pos[0])

    def _show_object(self, batch: GraspBatch | None) -> None:
        surface: Surface = "pieces" if self.surface.value == "pieces" else "mesh"
        if batch is None:
            self.nodes.show_object(self.solid, LIBRARY_SIZE, (0, 0, 0), (1, 0, 0, 0), surface)
            self.nodes.show_ground(None)
        else:
            self.nodes.show_scene(self.solid, batch, 0, surface)

    def _show_contacts(self, batch: GraspBatch) -> None:
        if has_pose(batch, 0):
            self.nodes.show_contacts(batch, 0)
        else:
            self.nodes.clear_contacts()

    def _aim_camera(self) -> None:
        size = LIBRARY_SIZE if self.batch is None else float(self.batch["size"][0])
        # A person who turned the view keeps it until another object or size comes, or the arms do.
        aimed = (self.solid.object_id, size, self.motion.shown)
        if self._aimed_at == aimed:
            return
        self._aimed_at = aimed
        motion = self.motion.motion if self.motion.shown else None
        if motion is None:
            self._look(view_of_grasp(self.catalog.hands, self.batch, 0, size))
        else:
            self._look(view_of_motion(motion))


def _direction(label: str) -> int:
    return 1 if label.startswith("next") else -1
