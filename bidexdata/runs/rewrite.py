"""Releases become another release: migrate, merge, split anew, take a part."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import NotUsable
from bidexdata.formats.citation import About
from bidexdata.formats.release import Release
from bidexdata.formats.rewrite import Rewriting, rewrite
from bidexdata.runs.progress import Progress
from bidexdata.runs.release_pictures import card_pictures

if TYPE_CHECKING:
    import pyarrow as pa

_OF_OBJECT = ("source", "source_name", "licence", "author", "category", "pieces", "volume")
"""Columns of the objects table that `where` may name beside those of scenes and grasps."""
_OF_SCENE = ("scene_id", "object_id", "size_mm", "setting", "split")


@dataclass(frozen=True, slots=True)
class RewriteReport:
    """What was written."""

    path: Path
    protocol: str
    figures: Mapping[str, Any] = field(default_factory=dict)
    """As in the manifest and the card."""
    whole_scenes: bool = True
    """Whether scenes were kept whole, so that the rates are still those of the generator."""


def migrate_release(
    path: str | Path, out: str | Path, *, pictures: bool = True, quiet: bool = False
) -> RewriteReport:
    """Write a release of any schema that was ever written under the schema of today.

    Rows, name, version and split are those of the release.

    Raises:
        PathNotFound: There is no release at `path`.
        Contradiction: Its major schema is newer than this version knows, or it is damaged.
        NotUsable: Its minor schema is newer, or `out` holds something.
    """
    release = Release.open(path)
    what = Rewriting(how="migrate", name=release.name, version=release.version)
    return _written([release], out, what, pictures=pictures, quiet=quiet)


def merge_releases(
    paths: Sequence[str | Path],
    out: str | Path,
    *,
    name: str,
    version: str,
    split: str | None = None,
    seed: int = 0,
    protocol: str | None = None,
    about: About | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> RewriteReport:
    """Join releases of the same hands.

    Args:
        paths: Two releases or more, each once.
        out: The new release's folder; must not exist or be empty.
        name: Name of the new data set.
        version: Its version, X.Y.Z.
        split: A new split (`object`, `category`, `size`); None keeps that of the releases, which
            must agree on every object that they share.
        seed: Seed of a new split.
        protocol: Whose verdicts are `suc_*`; None keeps that of the releases.
        about: Authors, date and address; None keeps those of the first.
        pictures: Draw the card's picture.
        quiet: No progress.

    Raises:
        NotUsable: The releases do not go together: another hand, one object with two shapes, the
            same grasp twice, one protocol's name with two settings, different splits.
    """
    folders = [Path(p).resolve() for p in paths]
    if len(set(folders)) < len(folders):
        twice = next(f for f in folders if folders.count(f) > 1)
        raise NotUsable(f"{twice} is named twice; name every release once")
    if len(folders) < 2:
        raise NotUsable("merge needs two releases or more")
    releases = [Release.open(p) for p in paths]
    what = Rewriting(
        how="merge",
        name=name,
        version=version,
        split_by=split,
        seed=seed,
        protocol=protocol,
        about=about,
    )
    return _written(releases, out, what, pictures=pictures, quiet=quiet)


def split_release(
    path: str | Path,
    out: str | Path,
    *,
    by: str,
    version: str,
    name: str | None = None,
    test_fraction: float = 0.2,
    seed: int = 0,
    pictures: bool = True,
    quiet: bool = False,
) -> RewriteReport:
    """Split the rows of a release anew.

    Args:
        path: The release.
        out: The new release's folder; must not exist or be empty.
        by: `object`, `category` or `size`.
        version: Of the new release, X.Y.Z.
        name: Of the new release; that of the old one when omitted.
        test_fraction: Share of objects, categories or sizes to test [-].
        seed: Another seed gives another split.
        pictures: Draw the card's picture.
        quiet: No progress.
    """
    release = Release.open(path)
    what = Rewriting(
        how="split",
        name=name or release.name,
        version=version,
        split_by=by,
        test_fraction=test_fraction,
        seed=seed,
    )
    return _written([release], out, what, pictures=pictures, quiet=quiet)


def subset_release(
    path: str | Path,
    out: str | Path,
    *,
    where: str,
    version: str,
    name: str | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> RewriteReport:
    """Write the part of a release that satisfies an expression.

    An expression over columns of objects and scenes alone (`category`, `licence`, `size_mm`,
    `setting` ...) keeps scenes whole, and with them what their rates mean. One over columns of
    grasps (`suc_f`, `pd` ...) chooses rows: what is left has no unselected rate.

    Args:
        path: The release.
        out: The new release's folder; must not exist or be empty.
        where: For example `"size_mm <= 500 and category in ['mug', 'bowl']"` or `"suc_f"`.
        version: Of the new release, X.Y.Z.
        name: Of the new release; that of the old one when omitted.
        pictures: Draw the card's picture.
        quiet: No progress.

    Raises:
        BadConfig: The expression cannot be read.
        UnknownName: It names a column that does not exist.
        NotUsable: Nothing satisfies it.
    """
    release = Release.open(path)
    scenes, choose = _chosen(release, where)
    what = Rewriting(
        how="subset",
        name=name or release.name,
        version=version,
        scenes=lambda scene: scene["scene_id"] in scenes,
        choose=choose,
        where=where,
    )
    if not scenes:
        raise NotUsable(f"no scene of {release.path} satisfies {where!r}")
    return _written([release], out, what, pictures=pictures, quiet=quiet)


def _chosen(
    release: Release, where: str
) -> tuple[set[str], Callable[[str, pa.Table], np.ndarray] | None]:
    """Scenes that an expression may keep rows of, and how it chooses among their rows."""
    from bidexdata.loaders.filters import columns_named, matching_rows

    named = set(columns_named(where) or ())
    objects = release.objects.select(["object_id", *_OF_OBJECT])
    scenes = release.scenes.select(list(_OF_SCENE))
    of_scenes = scenes.join(objects, "object_id").combine_chunks()
    if named <= set(of_scenes.column_names):
        kept = of_scenes.column("scene_id").take(matching_rows(where, of_scenes))
        return set(kept.to_pylist()), None
    about = {row["object_id"]: row for row in objects.to_pylist()}

    def choose(object_id: str, rows: pa.Table) -> np.ndarray:
        found = matching_rows(where, _with_object(rows, about[object_id]))
        return np.isin(np.arange(rows.num_rows), found)

    kept = _scenes_with(release, where, about)
    if not kept:
        raise NotUsable(f"no row of {release.path} satisfies {where!r}")
    return kept, choose


def _scenes_with(release: Release, where: str, about: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Scenes that have a row that satisfies an expression."""
    from bidexdata.loaders.filters import columns_named, matching_rows

    scalar = set(release.table_schema("grasps").names)
    wanted = [c for c in columns_named(where) or () if c in scalar and c not in _OF_OBJECT]
    names = list(dict.fromkeys(["scene_id", "object_id", *wanted]))
    found: set[str] = set()
    for configuration in release.configurations:
        for group in release.row_groups("grasps", configuration, columns=names):
            table = _with_objects(group, about)
            kept = group.column("scene_id").take(matching_rows(where, table))
            found.update(kept.unique().to_pylist())
    return found


def _with_object(rows: pa.Table, about: Mapping[str, Any]) -> pa.Table:
    """Scalar columns of rows of one object, with the object's own beside them."""
    import pyarrow as pa

    scalar = [f.name for f in rows.schema if not pa.types.is_fixed_size_list(f.type)]
    table = rows.select(scalar)
    for name in _OF_OBJECT:
        if name not in scalar:
            table = table.append_column(name, pa.array([about[name]] * rows.num_rows))
    return table


def _with_objects(rows: pa.Table, about: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    import pyarrow as pa

    owners = rows.column("object_id").combine_chunks().dictionary_encode()
    for name in _OF_OBJECT:
        values = pa.array([about[i][name] for i in owners.dictionary.to_pylist()])
        rows = rows.append_column(name, values.take(owners.indices))
    return rows


def _written(
    releases: Sequence[Release],
    out: str | Path,
    what: Rewriting,
    *,
    pictures: bool,
    quiet: bool,
) -> RewriteReport:
    objects = len({i for r in releases for i in r.object_ids})
    with Progress(objects, "object", quiet=quiet) as progress:
        summary = rewrite(
            releases,
            Path(out),
            what,
            pictures=card_pictures if pictures else None,
            on_object=lambda object_id: progress.advance(note=object_id),
        )
    written = Release.open(summary.path)
    whole = written.manifest["derived"]["whole_scenes"]
    return RewriteReport(summary.path, written.default_protocol, summary.figures, whole)
