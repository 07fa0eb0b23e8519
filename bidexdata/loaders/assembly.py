"""From columns of some rows to a batch: frames, clouds, augmentation, forms of rotations, tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Int

from bidexdata.loaders.augment import (
    HandPair,
    draw_angles,
    draw_mirrored,
    mirror,
    turn_about_gravity,
)
from bidexdata.loaders.clouds import CloudRows, distinct
from bidexdata.loaders.normals import CloudNormals
from bidexdata.loaders.options import HAND_POSES, POSE_OF_OBJECT, ItemOptions
from bidexdata.loaders.poses import points_in_world, poses_in_object_frame
from bidexdata.loaders.rotations import in_form, renamed

if TYPE_CHECKING:
    from bidexdata.formats.release import Release


class Selection(NamedTuple):
    """Which rows a batch is made of."""

    key: Int[np.ndarray, " n"]
    """What augmentation is drawn by: the row, or the scene where its grasps move together."""
    objects: Int[np.ndarray, " n"]
    """Numbers in `Release.object_ids`, int64."""
    kind: Int[np.ndarray, " n"] | None = None
    """Numbers of their objects and sizes among those that `CloudRows.keep` was given."""


class Gathered(NamedTuple):
    """Rows as they are stored, before a batch is made of them."""

    found: dict[str, np.ndarray]
    text: dict[str, list[str]]
    selection: Selection

    def part(self, low: int, high: int) -> Gathered:
        """The rows [low, high) of them, which are no copy."""
        key, objects, kind = self.selection
        return Gathered(
            {name: values[low:high] for name, values in self.found.items()},
            {name: words[low:high] for name, words in self.text.items()},
            Selection(key[low:high], objects[low:high], None if kind is None else kind[low:high]),
        )


class Assembly:
    """Makes batches of one release by some options.

    State: the clouds, and the hands' twins where grasps are mirrored.
    """

    def __init__(self, release: Release, options: ItemOptions, *, on_table: bool):
        """Open what batches need besides their rows.

        Args:
            release: The release.
            options: What an item is.
            on_table: Whether some objects have another pose than the identity.

        Raises:
            BadConfig: Fewer points are stored than asked for, or grasps cannot be mirrored.
        """
        import torch

        self.options, self.on_table = options, on_table
        self._tensor = torch.from_numpy
        self.clouds = None
        if options.cloud is not None:
            self.clouds = CloudRows(release, options.cloud, options.points)
        self._normals = CloudNormals(release, options.points) if options.normals else None
        self.pair = None
        if "mirror" in options.augment:
            from bidexdata.hands.tree_file import hand_of_release

            hands = [hand_of_release(release.path, h.side) for h in release.hands]
            self.pair = HandPair.of(hands)
        self._names = [
            (n, renamed(n, options.rotation, options.quat_order)) for n in options.fields
        ]
        self._converts = any(n != key for n, key in self._names)
        # Nothing but clouds is added to what is stored.
        self._plain_clouds = options.clouds == "expand" and options.frame == "object"
        self._plain_clouds &= not (options.augment or options.normals)

    def batch(self, rows: Gathered, epoch: int) -> dict[str, Any]:
        """Make a batch of tensors.

        Args:
            rows: The fields as stored, and what `ItemOptions.helpers` names.
            epoch: What augmentation depends on besides the key.
        """
        found, text, selection = rows
        options, tensor = self.options, self._tensor
        extra: dict[str, np.ndarray] = {"object_index": selection.objects}
        if self.clouds is not None and options.cloud is not None:
            extra |= self._clouds(found, selection)
        if self.on_table and options.frame == "object" and "hand_pos" in found:
            poses = [found[n] for n in (*POSE_OF_OBJECT, *HAND_POSES)]
            found |= dict(zip(HAND_POSES, poses_in_object_frame(*poses), strict=True))
        if options.augment:
            found, extra = self._augmented(found, extra, selection, epoch)
        if not self._converts and not text:
            out: dict[str, Any] = {n: tensor(found[n]) for n in options.fields}
            for name, values in extra.items():
                out[name] = tensor(values)
            return out
        out = {}
        for name, key in self._names:
            if name in text:
                out[key] = text[name]
                continue
            values = found[name]
            if key != name:
                values = in_form(values, options.rotation, options.quat_order)
            out[key] = tensor(values)
        return out | {name: tensor(values) for name, values in extra.items()}

    def _clouds(self, found: dict[str, np.ndarray], selection: Selection) -> dict[str, np.ndarray]:
        assert self.clouds is not None
        options, objects, sizes = self.options, selection.objects, found["size"]
        if self._plain_clouds:
            return {str(options.cloud): self.clouds.at_size(objects, sizes, selection.kind)}
        in_world = self.on_table and options.frame == "world"
        shared: Any = slice(None)
        out: dict[str, np.ndarray] = {}
        if options.clouds == "unique":
            kinds = [objects, sizes]
            if in_world or (self.on_table and options.augment):
                kinds += [found[n] for n in POSE_OF_OBJECT]
            if options.augment:
                kinds.append(selection.key)
            shared, out["point_index"] = distinct(*kinds)
        kind = None if selection.kind is None else selection.kind[shared]
        points = self.clouds.at_size(objects[shared], sizes[shared], kind)
        if in_world:
            pos, quat = (found[n][shared] for n in POSE_OF_OBJECT)
            points = points_in_world(pos, quat, points)
        if self._normals is not None:
            normals = self._normals.of(objects[shared])
            if in_world:
                quat = found["object_quat_wxyz"][shared]
                normals = points_in_world(np.zeros((len(quat), 3)), quat, normals)
            out["cloud_normal"] = normals
        return {str(options.cloud): points, **out}

    def _augmented(
        self,
        found: dict[str, np.ndarray],
        extra: dict[str, np.ndarray],
        selection: Selection,
        epoch: int,
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        options, key = self.options, selection.key
        kept, count = dict(found), len(key)
        total = np.broadcast_to(np.eye(3), (count, 3, 3))
        if self.pair is not None:
            chosen = draw_mirrored(options.seed, epoch, key)
            image, across = mirror(kept, self.pair)
            kept = {n: _where(chosen, image[n], kept[n]) for n in kept}
            total = np.where(chosen[:, None, None], across, total)
            extra = {**extra, "mirrored": chosen}
        if "yaw" in options.augment:
            angle = draw_angles(options.seed, epoch, key)
            kept, R = turn_about_gravity(kept, angle, options.frame)
            total = R @ total
        if options.cloud is not None:
            # Grasps that share a cloud share their key, so any of them tells how it is moved.
            first = np.arange(count)
            if "point_index" in extra:
                first = np.unique(extra["point_index"], return_index=True)[1]
            moved = np.swapaxes(total[first], 1, 2).astype(np.float32)
            moving = [n for n in (options.cloud, "cloud_normal") if n in extra]
            extra = {**extra, **{n: extra[n] @ moved for n in moving}}
        return kept, extra


def _where(chosen: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b)


def columns_needed(options: ItemOptions, *, on_table: bool) -> Sequence[str]:
    """Columns that must be read for a batch, text included."""
    return (*options.fields, *options.helpers(on_table=on_table))
