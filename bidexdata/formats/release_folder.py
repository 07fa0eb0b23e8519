"""A release folder opened: what its manifest says, its small tables, solids and clouds.

Opening reads the manifest only; the rest is read when it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction, NotUsable, UnknownName
from bidexdata.formats import hdf5, parquet, tables
from bidexdata.formats.clouds import CLOUDS, open_cloud
from bidexdata.formats.licences import IDS_ONLY
from bidexdata.formats.manifest import MANIFEST, read_manifest
from bidexdata.formats.rows import TestKey
from bidexdata.formats.splits import ALL
from bidexdata.kinds import expect_kind
from bidexdata.objects.library import object_folder
from bidexdata.objects.storage import read_solid
from bidexdata.record import HandHeader, Header

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.objects.prepared import Solid

Opened = TypeVar("Opened", bound="ReleaseFolder")
"""The folder, or a layer on top of it (`Self` is what beartype refuses in the tests)."""


class ShapesLeftOut(NotUsable):
    """A release names its objects, but their meshes and clouds are not in it."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(
            f"{path} has no meshes and no clouds (it was packed with --licences ids-only): prepare "
            "the source files that its objects.parquet names, then use the run or library"
        )


_KEYS = {
    *("name", "version", "schema_version", "figures", "default_protocol", "tests"),
    *("configurations", "splits"),
}


@dataclass(frozen=True)
class ReleaseFolder:
    """A release folder, opened: what it says of itself, its small tables, solids and clouds."""

    path: Path
    manifest: Mapping[str, Any]
    header: Header
    """Hands and versions, the same for all rows."""

    @classmethod
    def open(cls: type[Opened], path: str | Path) -> Opened:
        """Open a release after checking its manifest and schema version.

        Raises:
            PathNotFound: There is no release at `path`.
            Contradiction: The manifest is damaged, or the schema is newer than this package.
        """
        path = Path(path)
        expect_kind(path, "release")
        manifest = read_manifest(path)
        try:
            header = Header.from_json(manifest["header"])
            missing = sorted(_KEYS - set(manifest))
        except (KeyError, TypeError) as err:
            raise Contradiction(f"{path / MANIFEST}: incomplete manifest ({err!r})") from err
        if missing:
            raise Contradiction(f"{path / MANIFEST}: incomplete manifest, {missing[0]} is missing")
        stated = manifest["schema_version"]
        if stated != header.schema_version:
            raise Contradiction(
                f"{path / MANIFEST}: schema_version is {stated!r} and that of its header "
                f"{header.schema_version!r}; they must be the same"
            )
        return cls(path, manifest, header)

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.manifest["name"]

    @property
    def version(self) -> str:
        """The data set's own version, X.Y.Z."""
        return self.manifest["version"]

    @property
    def hands(self) -> tuple[HandHeader, ...]:
        """The H axis."""
        return self.header.hands

    @property
    def default_protocol(self) -> str:
        """Protocol of `suc_f`, `suc_l`, `suc_a` and of the metrics."""
        return self.manifest["default_protocol"]

    @property
    def protocols(self) -> tuple[TestKey, ...]:
        """The (protocol, test) pairs that have a verdict table."""
        return tuple((p, t) for p, t in self.manifest["tests"])

    @property
    def rig(self) -> str:
        """Name of the rig that the rows have arm solutions of; empty where they have none."""
        return self.header.arms[0].rig if self.header.arms else ""

    @property
    def protocol_settings(self) -> dict[str, Any]:
        """Settings of every protocol that has verdicts, plain data by name."""
        return self.manifest.get("protocols", {})

    @property
    def figures(self) -> dict[str, Any]:
        """Counts, rates and means of the default protocol, as the card states them."""
        return self.manifest["figures"]

    @property
    def other_figures(self) -> dict[str, Any]:
        """The same of every other protocol, by name; a release of an older version has none."""
        return self.manifest.get("other_figures", {})

    @property
    def form(self) -> str:
        """Where the rows stand: `parquet`, `hdf5`, or `both` (Parquet and the training form)."""
        trained = hdf5.TRAINING_FILE in self.manifest["files"]
        return self.manifest.get("form", "both" if trained else "parquet")

    @property
    def configurations(self) -> tuple[str, ...]:
        """`selected` (default) and `audit`."""
        return tuple(self.manifest["configurations"])

    @property
    def split_names(self) -> tuple[str, ...]:
        """Splits in reading order."""
        return tuple(name for name, _ in self.manifest["splits"])

    @cached_property
    def objects(self) -> pa.Table:
        """The objects table; columns that an older schema lacks say nothing."""
        table = parquet.read_table(self.path / "objects.parquet")
        return tables.completed(table, tables.OBJECT_FIELDS)

    @cached_property
    def scenes(self) -> pa.Table:
        """The scenes table; columns that an older schema lacks say nothing."""
        table = parquet.read_table(self.path / "scenes.parquet")
        return tables.completed(table, tables.SCENE_FIELDS)

    @cached_property
    def runs(self) -> pa.Table:
        """The runs table; columns that an older schema lacks say nothing."""
        table = parquet.read_table(self.path / "runs.parquet")
        return tables.completed(table, tables.RUN_FIELDS)

    @cached_property
    def object_ids(self) -> tuple[str, ...]:
        """All objects, sorted; their order is that of the clouds."""
        return tuple(self.objects.column("object_id").to_pylist())

    @cached_property
    def splits(self) -> dict[str, tuple[str, ...]]:
        """Objects of each split; under a split by size an object is in every split it has sizes in."""
        found: dict[str, list[str]] = {name: [] for name in self.split_names}
        names = self.objects.column("split").to_pylist()
        places = self._scene_splits if ALL in names else {}
        for object_id, split in zip(self.object_ids, names, strict=True):
            for name in places.get(object_id, ()) if split == ALL else (split,):
                found[name].append(object_id)
        return {k: tuple(v) for k, v in found.items()}

    @cached_property
    def _scene_splits(self) -> dict[str, list[str]]:
        columns = (self.scenes.column(n).to_pylist() for n in ("object_id", "split"))
        pairs = set(zip(*columns, strict=True))
        found: dict[str, list[str]] = {}
        for object_id, split in sorted(pairs):
            found.setdefault(object_id, []).append(split)
        return found

    @property
    def policy(self) -> str:
        """Licence policy that chose the objects; empty where none was asked for."""
        return self.manifest.get("licences", "")

    @property
    def has_shapes(self) -> bool:
        """Whether meshes, pieces and clouds are in it: not under the policy `ids-only`."""
        return self.policy != IDS_ONLY

    def require_shapes(self) -> None:
        """Refuse what needs meshes where there are none.

        Raises:
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        if not self.has_shapes:
            raise ShapesLeftOut(self.path)

    def load_solid(self, object_id: str) -> Solid:
        """Read the solid of one object.

        Raises:
            UnknownName: The release has no such object.
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        self._check_object(object_id)
        self.require_shapes()
        return read_solid(self.path / object_folder(object_id))

    def cloud(self, kind: str = "cloud_solid", object_id: str | None = None) -> NDArray[np.float32]:
        """Point clouds at unit diagonal: all (K, P, 3), mapped, or one object's (P, 3).

        Raises:
            UnknownName: No such kind or object.
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        if kind not in CLOUDS:
            raise UnknownName("cloud", kind, CLOUDS)
        self.require_shapes()
        every = open_cloud(self.path / "clouds" / f"{kind}.npy")
        if object_id is None:
            return every
        self._check_object(object_id)
        return np.asarray(every[self.object_ids.index(object_id)])

    def _check_object(self, object_id: str) -> None:
        if object_id not in self.object_ids:
            raise UnknownName("object", object_id, self.object_ids)
