"""A scene's id can be taken apart again."""

import pytest

from bidexdata.record import Scene
from bidexdata.record.scene import scene_parts


@pytest.mark.parametrize(
    "scene",
    [
        Scene("mug-0a1b2c3d", 300),
        Scene("mug-0a1b2c3d", 850, "tabletop", 0),
        Scene("a/b/кружка-0a1b2c3d", 55, "tabletop", 12),
    ],
)
def test_a_scene_id_says_what_it_was_made_of(scene):
    parts = scene_parts(scene.scene_id)
    assert parts == (scene.object_id, scene.size_mm, scene.rest_pose)
    assert parts.setting == scene.setting
