"""One page: its widgets, what they mean, and what happens when one changes.

Every browser gets a page of its own, so two people do not turn each other's pages.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.drawing import Surface
from bidexdata.pictures.posing import poses_at
from bidexdata.pictures.views import side_direction
from bidexdata.record import GraspBatch
from bidexdata.viewer.catalog import KEPT, OUTCOMES, Catalog, matching_rows
from bidexdata.viewer.nodes import GraspNodes
from bidexdata.viewer.words import (
    identity_markdown,
    object_markdown,
    scores_markdown,
    verdict_html,
)
from bidexdata.wording import counted

if TYPE_CHECKING:
    import viser

Aim = Callable[[NDArray[np.float64], NDArray[np.float64]], None]
"""Points a camera: position and the point it looks at [m]."""

ALL_SIZES = "all sizes"
NO_MATCH = "No grasp matches the filters."
LIBRARY_SIZE = 0.4
"""Diagonal at which a library's objects are shown [m]."""
STAGE_MARKS = ((0.0, "pre-grasp"), (1.0, "grasp"), (2.0, "squeeze"))
FIELD_OF_VIEW = float(np.radians(35.0))
"""Vertical opening angle of the page's camera [rad]; viser's own is 75 degrees."""
PLAY_SECONDS = 2.5
_PLAY_STEPS = 50
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
        aim: Points the camera.
    """

    def __init__(self, gui: viser.GuiApi, scene: viser.SceneApi, catalog: Catalog, aim: Aim):
        self._gui, self.catalog, self._aim = gui, catalog, aim
        self._lock = threading.RLock()
        self._setting = False  # a widget is being set from here, not by the person
        self._playing = self._closed = False
        self._aimed_at: tuple[str, float] | None = None
        self.tested: dict[str, GraspBatch] = {}
        self.batch: GraspBatch | None = None
        self.rows: list[int] = []
        self._has_grasps = catalog.source.kind != "library"
        self._build_widgets()
        self._build_keys()
        self.nodes = GraspNodes(scene, catalog.hands)
        self.open_object()

    @property
    def row(self) -> int | None:
        """The row that is shown; None when no row matches the filters."""
        return self.rows[int(self.grasp.value) - 1] if self.rows else None

    def open_object(self) -> None:
        """Show the object that its widget names: read it, offer its sizes, apply the filters."""
        with self._lock:
            object_id = str(self.object.value)
            self.solid = self.catalog.solid(object_id)
            self.tested = self.catalog.grasps(object_id)
            self.batch = next(iter(self.tested.values()), None)
            sizes = sorted(set(self.batch["size_mm"].tolist())) if self.batch is not None else []
            self._set(self.size, options=(ALL_SIZES, *(f"{s} mm" for s in sizes)))
            self.about.content = object_markdown(self.solid)
            self.apply_filters()

    def apply_filters(self) -> None:
        """Find the rows that match the widgets and show the first."""
        with self._lock:
            size = str(self.size.value)
            self.rows = matching_rows(
                self.batch,
                size_mm=None if size == ALL_SIZES else int(size.split(maxsplit=1)[0]),
                outcome=self.outcome.value,
                kept=self.kept.value,
            )
            count = len(self.rows)
            self._set(self.grasp, max=max(count, 2), disabled=count < 2)
            self._set(self.grasp, value=1)
            self.show_grasp()

    def show_grasp(self) -> None:
        """Show the chosen row: object at its pose, contacts, words, hands at the stage."""
        with self._lock:
            row, batch = self.row, self.batch
            self._show_object(batch, row)
            if batch is None or row is None:
                self.nodes.clear_contacts()
                self.verdict.content = NO_MATCH if self._has_grasps else ""
                self.identity.content = self.scores.content = ""
            else:
                self.nodes.show_contacts(batch, row)
                self.verdict.content = verdict_html(self.tested, row)
                self.identity.content = identity_markdown(batch, row)
                self.scores.content = scores_markdown(self.tested, row)
            total = len(self.rows)
            self.count.content = (
                f"{int(self.grasp.value) if total else 0} of {counted(total, 'grasp')}"
            )
            self.show_marks()
            self.show_stage()
            self._aim_camera()

    def show_stage(self) -> None:
        """Move the hands to the stage slider's moment."""
        with self._lock:
            if self.batch is None or self.row is None:
                self.nodes.pose(None)
            else:
                self.nodes.pose(poses_at(self.batch, self.row, float(self.stage.value)))

    def show_marks(self) -> None:
        """Show or hide contacts and forces as their boxes say."""
        self.nodes.set_visible(contacts=self.contacts.value, forces=self.forces.value)

    def step_grasp(self, by: int) -> None:
        """Go to the next (1) or previous (-1) grasp; past the last object's end, start over."""
        with self._lock:
            if self.rows:
                at = (int(self.grasp.value) - 1 + by) % len(self.rows)
                self._set(self.grasp, value=at + 1)
                self.show_grasp()

    def step_object(self, by: int) -> None:
        """Go to the next (1) or previous (-1) object."""
        with self._lock:
            ids = self.catalog.object_ids
            at = (ids.index(str(self.object.value)) + by) % len(ids)
            self._set(self.object, value=ids[at])
            self.open_object()

    def set_stage(self, moment: float) -> None:
        """Put the stage slider somewhere."""
        self._set(self.stage, value=moment)
        self.show_stage()

    def play(self) -> None:
        """Move from pre-grasp to squeeze; a second press while it moves does nothing."""
        with self._lock:
            if self._playing or self.row is None:
                return
            self._playing = True
        try:
            for moment in np.linspace(0, 2, _PLAY_STEPS):
                if self._closed:
                    break
                self.set_stage(round(float(moment), 2))
                time.sleep(PLAY_SECONDS / _PLAY_STEPS)
        finally:
            self._playing = False

    def close(self) -> None:
        """End what still moves: the browser is gone."""
        self._closed = True

    def _build_widgets(self) -> None:
        gui, ids, shown = self._gui, self.catalog.object_ids, self._has_grasps
        with gui.add_folder("Object"):
            self.object = gui.add_dropdown("object", ids, initial_value=ids[0])
            self.surface = gui.add_dropdown(
                "shape",
                ("mesh", "pieces"),
                initial_value="mesh" if shown else "pieces",
                hint="repaired mesh, or the convex pieces that are simulated",
            )
            objects = gui.add_button_group("turn to", ("previous object", "next object"))
            self.about = gui.add_markdown("")
        with gui.add_folder("Filter", visible=shown):
            self.size = gui.add_dropdown("size", (ALL_SIZES,))
            self.outcome = gui.add_dropdown("outcome", OUTCOMES, hint=self._outcome_hint())
            self.kept = gui.add_dropdown("rows", KEPT, hint="selected: best; audit: drawn by seed")
        with gui.add_folder("Grasp", visible=shown):
            self.count = gui.add_markdown("")
            self.grasp = gui.add_slider("grasp", 1, 2, 1, 1)
            grasps = gui.add_button_group("go to", ("previous", "next"))
            self.stage = gui.add_slider("stage", 0.0, 2.0, 0.02, 1.0, marks=STAGE_MARKS)
            play = gui.add_button("play", hint="pre-grasp to squeeze")
            self.contacts = gui.add_checkbox("contacts and normals", True)
            self.forces = gui.add_checkbox("forces", False, hint="of the zero-load QP, orange")
        with gui.add_folder("Verdict and scores", visible=shown):
            self.verdict = gui.add_html("")
            self.identity = gui.add_markdown("")
            self.scores = gui.add_markdown("")
        with gui.add_folder("Keys", expand_by_default=False):
            gui.add_markdown(KEYS if shown else "**O** / **shift O** next / previous object")

        self._on_update(self.object, self.open_object)
        for widget in (self.size, self.outcome, self.kept):
            self._on_update(widget, self.apply_filters)
        for widget in (self.grasp, self.surface):
            self._on_update(widget, self.show_grasp)
        self._on_update(self.stage, self.show_stage)
        for widget in (self.contacts, self.forces):
            self._on_update(widget, self.show_marks)
        objects.on_click(lambda _: self.step_object(_direction(objects.value)))
        grasps.on_click(lambda _: self.step_grasp(_direction(grasps.value)))
        play.on_click(lambda _: self.play())

    def _outcome_hint(self) -> str:
        source = self.catalog.source
        return f"of test {source.test} of {source.protocol}" if source.test else "not validated"

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

    def _show_object(self, batch: GraspBatch | None, row: int | None) -> None:
        surface: Surface = "pieces" if self.surface.value == "pieces" else "mesh"
        if batch is None or row is None:
            self.nodes.show_object(self.solid, LIBRARY_SIZE, (0, 0, 0), (1, 0, 0, 0), surface)
            self.nodes.show_ground(None)
            return
        size = float(batch["size"][row])
        pos, quat = batch["object_pos"][row], batch["object_quat_wxyz"][row]
        self.nodes.show_object(self.solid, size, pos, quat, surface)
        self.nodes.show_ground(size if str(batch["setting"][row]) == "tabletop" else None)

    def _aim_camera(self) -> None:
        batch, row = self.batch, self.row
        if batch is None or row is None:
            centre, size, hands = np.zeros(3), LIBRARY_SIZE, []
        else:
            centre = np.asarray(batch["object_pos"][row], np.float64)
            size = float(batch["size"][row])
            hands = list(np.asarray(batch["hand_pos"][row, :, 1], np.float64))
        # A person who turned the view keeps it until another object or size comes.
        if self._aimed_at == (self.solid.object_id, size):
            return
        self._aimed_at = (self.solid.object_id, size)
        # The hands reach about 0.2 m beyond the object on both sides.
        away = 0.5 * (size + (0.45 if hands else 0.1)) / np.tan(0.5 * FIELD_OF_VIEW)
        seen = [centre, *hands] if len(hands) == 1 else hands
        self._aim(centre + away * side_direction(seen), centre)


def _direction(label: str) -> int:
    return 1 if label.startswith("next") else -1
