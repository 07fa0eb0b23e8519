"""The widgets of a page that move the arms: a box that shows them, and a slider over the time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.record.fields import KEY_FRAMES

if TYPE_CHECKING:
    import viser

    from bidexdata.arms.motion import Motion

MARKED = {"home": "home", "grasp": "grasp", "lift": "lift"}
"""Key frames whose marks have words: the others stand too close for them."""
_STEP = 0.02
"""Of the slider [s]."""
_FIRST = float(KEY_FRAMES.index("grasp"))
_PREGRASP = KEY_FRAMES.index("pregrasp")


class MotionPanel:
    """Widgets of the motion of one grasp.

    Args:
        gui: Where they go; the folder that is open.
        folder: That folder.
        rig: Name of the rig; empty where nothing has arms, and then nothing shows.
        toggled: Called when the box changes.
        moved: Called when the slider moves.
        watch: Calls back when a widget is changed by a person.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        folder: Any,
        rig: str,
        toggled: Callable[[], None],
        moved: Callable[[], None],
        watch: Callable[[Any, Callable[[], None]], None],
    ):
        self._gui, self._folder, self._moved, self._watch = gui, folder, moved, watch
        self.motion: Motion | None = None
        self._frame = _FIRST  # where the slider is, as a place among the key frames
        self.arms = gui.add_checkbox("arms", True, visible=bool(rig), hint=f"of the rig {rig}")
        self.time = self._slider(np.arange(float(len(KEY_FRAMES))))
        watch(self.arms, toggled)

    @property
    def shown(self) -> bool:
        """Whether there are arms to see, and a person wants to."""
        return self.motion is not None and bool(self.arms.value)

    def offer(self, motion: Motion | None) -> None:
        """Take the motion of another grasp; the slider stays at its place among the key frames."""
        if self.motion is not None and self.time.visible:
            self._frame = float(
                np.interp(self.time.value, self.motion.key_time, np.arange(len(KEY_FRAMES)))
            )
        self.motion = motion
        self.arms.disabled = motion is None
        if motion is not None:
            order = float(self.time.order)
            self.time.remove()
            with self._folder:
                self.time = self._slider(motion.key_time, order=order)
        self.show()

    def show(self) -> None:
        """Show the slider where there are arms."""
        self.time.visible = self.shown

    def time_of_stage(self, stage: float) -> float:
        """When the motion is at a stage (0 pregrasp, 1 grasp, 2 squeeze) [s]."""
        assert self.motion is not None
        times = self.motion.key_time[_PREGRASP : _PREGRASP + 3]
        return float(np.interp(stage, np.arange(3.0), times))

    def _slider(self, key_time: np.ndarray, order: float | None = None) -> Any:
        end = float(key_time[-1])
        marks = tuple(
            (float(time), MARKED[name]) if name in MARKED else float(time)
            for name, time in zip(KEY_FRAMES, key_time, strict=True)
        )
        at = float(np.interp(self._frame, np.arange(len(KEY_FRAMES)), key_time))
        slider = self._gui.add_slider(
            "time [s]", 0.0, end, _STEP, at, marks=marks, visible=False, order=order
        )
        self._watch(slider, self._moved)
        return slider
