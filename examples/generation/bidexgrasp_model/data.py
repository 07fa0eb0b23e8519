"""Batches of cases: scenes with their successful grasps, from a release through its loader."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexdata import Release
from bidexdata.loaders import BiDexCases, collate_cases
from bidexgrasp_model.config import Config
from bidexgrasp_model.rotations import matrix_from_quat
from bidexgrasp_model.single_view import Body, bodies_of, seen_cloud
from bidexgrasp_model.state import GRASP, Poses
from bidexgrasp_model.tables import Tables, cached_tables, sphere_of, tables_of
from bidexgrasp_model.views import candidate_views, nearest_view, view_labels

FIELDS = ("hand_pos", "hand_quat_wxyz", "joints", "object_pos", "object_quat_wxyz", "size")


class CaseBatch(NamedTuple):
    """B cases and n grasps of theirs, in the world frame."""

    clouds: Float[Tensor, "B P 3"]
    """In farthest-point order [m]."""
    solid: Float[Tensor, "B P 3"]
    """The whole surface, for losses: the same unless clouds are seen from one side [m]."""
    normals: Float[Tensor, "B P 3"]
    """Outward, at `solid`."""
    tables: Tables
    case: Int[Tensor, " n"]
    """Which case each grasp is of."""
    poses: Poses
    view: Int[Tensor, "n 2"]
    """Nearest views of the hands."""
    y: Float[Tensor, "B 2 K"]
    y_bi: Float[Tensor, "B K K"]

    def to(self, device: torch.device) -> CaseBatch:
        """On another device."""
        return CaseBatch(
            self.clouds.to(device),
            self.solid.to(device),
            self.normals.to(device),
            self.tables.to(device),
            self.case.to(device),
            Poses(*(part.to(device) for part in self.poses)),
            self.view.to(device),
            self.y.to(device),
            self.y_bi.to(device),
        )


@dataclass(frozen=True, slots=True)
class ReleaseId:
    """Which data a checkpoint was trained on."""

    name: str
    version: str
    fingerprint: str

    @classmethod
    def of(cls, release: Release) -> ReleaseId:
        """Name and hash a release by its manifest."""
        digest = hashlib.sha256((release.path / "manifest.json").read_bytes()).hexdigest()
        return cls(release.name, release.version, digest[:16])


class Cases:
    """The cases of one split, each with all the grasps that passed the test.

    An item is a case as `BiDexCases` gives it; `batch` makes items into what the model trains on.
    """

    def __init__(
        self,
        root: str | Path,
        config: Config,
        *,
        split: str = "train",
        where: str | None = None,
        augment: bool = True,
        cache: str | Path | None = None,
        seed: int = 0,
        only: int | None = None,
    ):
        """Open a release.

        Args:
            root: Its folder; split by objects.
            config: Points, groups, augmentation.
            split: `train` or `test`.
            where: Which grasps; those that pass the strictest test of the release when omitted.
            augment: Turn and mirror cases anew each epoch.
            cache: Folder of the neighbour tables; none are kept when omitted.
            seed: Of the augmentation.
            only: The first so many cases alone, spread over all: for over-fitting.
        """
        self.release = Release.open(root)
        self.config, self.where = config, where or _passed(self.release)
        self.cases = BiDexCases(
            root,
            split=split,
            where=self.where,
            fields=FIELDS,
            frame="world",
            points=config.model.points,
            normals=True,
            augment=config.train.augment if augment else (),
            seed=seed,
        )
        self.id = ReleaseId.of(self.release)
        self._known_bodies: dict[str, list[Body]] = {}
        self.views = candidate_views(config.model.views)
        count = len(self.cases)
        self.chosen = list(range(count))
        if only is not None:
            self.chosen = [k * count // only for k in range(min(only, count))]
        folder = Path(cache) if cache is not None else None
        self.tables = self._tables(folder)

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.cases[self.chosen[index]]

    def set_epoch(self, epoch: int) -> None:
        """Draw the augmentation anew."""
        self.cases.set_epoch(epoch)

    def batch(
        self, items: Sequence[Mapping[str, Any]], generator: torch.Generator | None = None
    ) -> CaseBatch:
        """Put cases together: label views by all grasps, keep some of them at random.

        Args:
            items: Cases.
            generator: Of the choice of grasps and of cameras.
        """
        packed = collate_cases(items)
        clouds = solid = packed["cloud_solid"]
        tables = self.tables.of(packed["object_index"])
        if self.config.train.single_view > 0:
            clouds, tables = self._one_sided(items, clouds, tables, generator)
        case, poses = packed["case_index"], poses_of(packed)
        view = self._views(clouds, tables, case, poses)
        labels = [view_labels(view[case == b], len(self.views)) for b in range(len(items))]
        keep = self._drawn(packed["case_offsets"], generator)
        return CaseBatch(
            clouds,
            solid,
            packed["cloud_normal"],
            tables,
            case[keep],
            Poses(*(part[keep] for part in poses)),
            view[keep],
            torch.stack([y for y, _ in labels]),
            torch.stack([y for _, y in labels]),
        )

    def _tables(self, folder: Path | None) -> Tables:
        model = self.config.model
        clouds = self.release.cloud("cloud_solid")
        if folder is None:
            import tempfile

            with tempfile.TemporaryDirectory() as temporary:
                return cached_tables(clouds, model, Path(temporary), self.id.fingerprint)
        return cached_tables(clouds, model, folder, self.id.fingerprint)

    def _views(
        self, clouds: Tensor, tables: Tables, case: Tensor, poses: Poses
    ) -> Int[Tensor, "n 2"]:
        centre, _ = sphere_of(clouds, tables)
        wrists = poses.pos[:, :, GRASP]
        return nearest_view(wrists, centre[case][:, None].expand_as(wrists), self.views)

    def _drawn(
        self, offsets: Int[Tensor, " B1"], generator: torch.Generator | None
    ) -> Int[Tensor, " n"]:
        """At most `train.grasps` of each case, without repetition."""
        kept = []
        for low, high in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
            order = torch.randperm(high - low, generator=generator)
            kept.append(low + order[: self.config.train.grasps])
        return torch.cat(kept)

    def _one_sided(
        self,
        items: Sequence[Mapping[str, Any]],
        clouds: Tensor,
        tables: Tables,
        generator: torch.Generator | None,
    ) -> tuple[Tensor, Tables]:
        """Replace a share of clouds by what a camera sees of the objects: rendered depth."""
        share = self.config.train.single_view
        partial = torch.rand(len(clouds), generator=generator) < share
        clouds = clouds.clone()
        parts = [t.clone() for t in tables]
        for b in partial.nonzero().flatten().tolist():
            seed = int(torch.randint(0, 2**31, (1,), generator=generator))
            bodies = [body.moved(*_motion(items[b])) for body in self._bodies(items[b])]
            cloud = seen_cloud(bodies, clouds.shape[1], np.random.default_rng(seed))
            clouds[b] = torch.from_numpy(cloud)
            found = tables_of(clouds[b : b + 1], self.config.model)
            for part, one in zip(parts, found, strict=True):
                part[b] = one[0].to(part.dtype)
        return clouds, Tables(*parts)

    def _bodies(self, item: Mapping[str, Any]) -> list[Body]:
        object_id = self.release.object_ids[int(item["object_index"])]
        if object_id not in self._known_bodies:
            self._known_bodies[object_id] = bodies_of(self.release.load_solid(object_id).pieces)
        return self._known_bodies[object_id]


def _motion(item: Mapping[str, Any]) -> tuple[np.ndarray, float, np.ndarray]:
    """R, size and pos that bring the object of a case to its place.

    Of a mirrored case R holds the mirror, which `BiDexDataset` takes across y.
    """
    R = matrix_from_quat(item["object_quat_wxyz"].double()).numpy()
    if bool(item.get("mirrored", False)):
        R = R @ np.diag([1.0, -1.0, 1.0])
    return R, float(item["size"]), item["object_pos"].double().numpy()


def poses_of(packed: Mapping[str, Any]) -> Poses:
    """The hands' poses of a batch of the loader; padded joints are 0."""
    return Poses(
        packed["hand_pos"],
        matrix_from_quat(packed["hand_quat_wxyz"]),
        packed["joints"].nan_to_num(),
    )


def _passed(release: Release) -> str:
    """The strictest test that the release has verdicts of."""
    tests = {test for _, test in release.protocols}
    for test in ("l", "f"):
        if test in tests:
            return f"suc_{test}"
    raise ValueError(f"{release.path} has no verdicts: run `bidexdata validate` before `pack`")
