"""The camera of one browser: it has a view in the picture until a person turns it.

The picture is what the panel leaves free of the window: the panel is docked beside it. How wide
that is, is known late: the browser docks the panel after it has called, and people resize windows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bidexdata.viewer.view import FIELD_OF_VIEW, Aim, View

if TYPE_CHECKING:
    import viser

_SAME_ASPECT = 0.01
"""Relative."""
_SAME_PLACE = 1e-3
"""Between where the camera was sent and where it says it is, of its distance: numbers are rounded."""


class PageCamera:
    """Points the camera of a client at views.

    Args:
        client: Whose; its `camera` is read and set.
    """

    def __init__(self, client: viser.ClientHandle):
        self._client = client
        self._view: View | None = None
        self._aspect = 0.0
        self._aim: Aim | None = None
        self._arrived = self._turned = False
        client.camera.on_update(lambda _: self.moved())

    def show(self, view: View) -> None:
        """Have a view in the picture."""
        self._view, self._turned = view, False
        self._point()

    def moved(self) -> None:
        """The browser says where its camera is, and how large its picture: fit the view anew.

        A camera that was where it was sent, and is elsewhere, was turned by a person, who keeps it.
        """
        if self._aim is None:
            return
        away = np.linalg.norm(self._aim.position - self._aim.target)
        off = np.linalg.norm(np.asarray(self._client.camera.position) - self._aim.position)
        at_place = bool(off < _SAME_PLACE * away)
        self._turned |= self._arrived and not at_place
        self._arrived |= at_place
        if not self._turned and abs(self._now() / self._aspect - 1) > _SAME_ASPECT:
            self._point()

    def _point(self) -> None:
        assert self._view is not None
        self._aspect = self._now()
        self._aim, self._arrived = self._view.aim(self._aspect), False
        with self._client.atomic():
            self._client.camera.fov = FIELD_OF_VIEW
            self._client.camera.position = self._aim.position
            self._client.camera.look_at = self._aim.target

    def _now(self) -> float:
        camera = self._client.camera
        if not camera.image_height or not camera.image_width:  # a window without a picture
            return self._aspect or 1.0
        return camera.image_width / camera.image_height
