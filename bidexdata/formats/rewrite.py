"""Releases become another release: one engine for migrate, merge, split and subset.

Everything is streamed object by object (`formats.stored_rows`) into the one writer, so that what comes
out obeys the same laws, and its figures, pages and manifest are made anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

from bidexdata.errors import NotUsable
from bidexdata.formats.citation import About
from bidexdata.formats.licences import IDS_ONLY, POLICIES
from bidexdata.formats.manifest import MANIFEST, sha256_of
from bidexdata.formats.pages import Picture
from bidexdata.formats.release import Release
from bidexdata.formats.rig_files import ReleaseRig, read_rig_files
from bidexdata.formats.rows import ReleaseRows, RunInfo
from bidexdata.formats.splits import ALL, Splitting, check_rule
from bidexdata.formats.stored_parts import StoredParts, run_infos, tests_of
from bidexdata.formats.stored_rows import Choose, StoredRows
from bidexdata.formats.writer import Form, ReleaseSummary, check_names, write_release
from bidexdata.record.batch import SCHEMA_VERSION, number_of
from bidexdata.record.settings import shared_settings

How = Literal["migrate", "merge", "split", "subset"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rewriting:
    """What becomes of some releases."""

    how: How
    name: str
    version: str
    scenes: Callable[[Mapping[str, Any]], bool] = lambda _: True
    """Which scenes, by their row of the scenes table."""
    choose: Choose | None = None
    """Which rows of them; the rates of what comes out are then no unselected rates."""
    where: str = ""
    """The same in words, for the manifest and the card."""
    split_by: str | None = None
    """A new split; None keeps that of the releases, which must agree."""
    test_fraction: float = 0.2
    seed: int = 0
    protocol: str | None = None
    """Whose verdicts are `suc_*` and the metrics; None keeps that of the releases."""
    form: Form | None = None
    """None keeps that of the first release."""
    about: About | None = None
    """None keeps what the first release says."""


def rewrite(
    releases: Sequence[Release],
    out: Path,
    what: Rewriting,
    *,
    pictures: Callable[[Path, Mapping[str, Any]], Sequence[Picture]] | None = None,
    on_object: Callable[[str], None] | None = None,
) -> ReleaseSummary:
    """Write a release of the rows of others.

    Args:
        releases: Of the same hands.
        out: The new release's folder; must not exist or be empty.
        what: What becomes of them.
        pictures: Draws the card's pictures; see `write_release`.
        on_object: Called after each object, for progress.

    Raises:
        NotUsable: The releases do not go together, a row is there twice, no row is left, or a
            release is of a newer schema.
        UnknownName: There are no verdicts of the protocol.
        BadValue: The name or version cannot be used.
    """
    if what.split_by is not None:
        check_rule(what.split_by)
    check_names(out, what.name, what.version, what.form or _form(releases[0]))
    _refuse_newer(releases)
    _check_together(releases)
    sources = _sources(releases, what)
    ids = sorted({i for source in sources for i in source.object_ids})
    if not ids:
        raise NotUsable("no scene is left: a release needs one at least")
    policy = _policy(releases)
    parts = StoredParts(releases)
    tests = tests_of(releases)
    return write_release(
        out,
        name=what.name,
        version=what.version,
        object_ids=ids,
        rows_of=lambda object_id: _rows_of(sources, object_id),
        runs=_runs(releases, sources, chosen=what.choose is not None),
        tests=tests,
        default_protocol=_protocol(releases, what.protocol),
        protocols=shared_settings(
            ((r.path, r.protocol_settings) for r in releases), "they cannot be one release"
        ),
        splitting=_kept_split(releases, parts, ids) if what.split_by is None else None,
        split_by=what.split_by or "object",
        sizes_mm={int(s["size_mm"]) for source in sources for s in source.scenes},
        seed=what.seed,
        test_fraction=what.test_fraction,
        form=what.form or _form(releases[0]),
        licences=policy,
        about=what.about or About.of(releases[0].manifest),
        pictures=pictures,
        stored=parts,
        derived=_derived(releases, what),
        rig=_rig(releases),
        on_object=on_object,
    )


def _form(release: Release) -> Form:
    return cast("Form", release.form)


class _Source(NamedTuple):
    rows: StoredRows
    names: dict[str, str]
    """Name of every run in the new release."""

    @property
    def object_ids(self) -> tuple[str, ...]:
        return self.rows.object_ids

    @property
    def scenes(self) -> Iterator[Mapping[str, Any]]:
        return self.rows.scenes


def _sources(releases: Sequence[Release], what: Rewriting) -> list[_Source]:
    """Rows of every release, its runs named apart unless they are the same run."""
    known: dict[str, RunInfo] = {}
    sources = []
    for release in releases:
        names = {}
        for run in run_infos(release):
            name, number = run.name, 1
            while known.setdefault(name, run) not in (run, replace(run, name=name)):
                number += 1
                name = f"{run.name}-{number}"
            known[name] = replace(run, name=name)
            names[run.name] = name
        rows = StoredRows(release, scenes=what.scenes, choose=what.choose, run_names=names)
        sources.append(_Source(rows, names))
    return sources


def _runs(
    releases: Sequence[Release], sources: Sequence[_Source], *, chosen: bool
) -> list[RunInfo]:
    runs = {}
    for release, source in zip(releases, sources, strict=True):
        for run in run_infos(release):
            name = source.names[run.name]
            runs[name] = replace(run, name=name, grasps=None if chosen else run.grasps)
    return list(runs.values())


def _rows_of(sources: Sequence[_Source], object_id: str) -> Iterator[ReleaseRows]:
    """Rows of one object; a scene that a run has in two releases tells its attempts once."""
    told: set[tuple[str, str]] = set()
    for source in sources:
        if object_id not in source.rows:
            continue
        for part in source.rows.rows_of(object_id):
            counts = part.batch.header.counts
            new = {s: c if (part.run, s) not in told else {} for s, c in counts.items()}
            told |= {(part.run, s) for s in counts}
            batch = replace(part.batch, header=replace(part.batch.header, counts=new))
            yield replace(part, batch=batch)


def _refuse_newer(releases: Sequence[Release]) -> None:
    for release in releases:
        theirs = release.header.schema_version
        if number_of(theirs) > number_of(SCHEMA_VERSION):
            raise NotUsable(
                f"{release.path} has schema {theirs}, and this version of bidexdata writes "
                f"{SCHEMA_VERSION}, which would lose columns; upgrade it with "
                "`pip install -U bidexdata`"
            )


def _check_together(releases: Sequence[Release]) -> None:
    first = releases[0]
    shapes: dict[str, tuple[str, Path]] = {}
    for release in releases:
        if release.hands != first.hands:
            theirs, ours = (
                ", ".join(f"{h.name} {h.side}" for h in r.hands) for r in (release, first)
            )
            raise NotUsable(
                f"{release.path} has other hands ({theirs}) than {first.path} ({ours}), or another "
                "version of them; they cannot be one release"
            )
        columns = (release.objects.column(n).to_pylist() for n in ("object_id", "shape_sha256"))
        for object_id, shape in zip(*columns, strict=True):
            known, where = shapes.setdefault(object_id, (shape, release.path))
            if known != shape:
                raise NotUsable(
                    f"object {object_id} has another shape in {release.path} than in {where}; "
                    "releases of equally prepared objects can be merged"
                )


def _rig(releases: Sequence[Release]) -> ReleaseRig | None:
    """The rig of the arm solutions that some of the releases have."""
    found: tuple[Release, ReleaseRig] | None = None
    for release in releases:
        if not release.rig:
            continue
        rig = read_rig_files(release.path, release.header.arms)
        if found is None:
            found = release, rig
        elif (found[1].arms, found[1].document) != (rig.arms, rig.document):
            raise NotUsable(
                f"{release.path} has arm solutions of rig {rig.name} and {found[0].path} of "
                f"{found[1].name}, or of another version of it; they cannot be one release"
            )
    return None if found is None else found[1]


def _protocol(releases: Sequence[Release], wanted: str | None) -> str:
    from bidexdata.errors import UnknownName

    if wanted is not None:
        known = sorted({p for p, _ in tests_of(releases)})
        if wanted not in known:
            raise UnknownName("protocol", wanted, known, "these have verdicts here")
        return wanted
    defaults = sorted({r.default_protocol for r in releases})
    if len(defaults) > 1:
        raise NotUsable(
            f"the releases have different default protocols ({', '.join(defaults)}); say with "
            "--protocol whose verdicts are suc_f, suc_l, suc_a and the metrics"
        )
    return defaults[0]


def _policy(releases: Sequence[Release]) -> str:
    """The narrowest promise that holds for all: no shapes where one has none."""
    policies = [r.policy for r in releases]
    if "" in policies and IDS_ONLY not in policies:
        return ""
    return max((p for p in policies if p), key=[*POLICIES].index, default="")


def _kept_split(releases: Sequence[Release], parts: StoredParts, ids: Sequence[str]) -> Splitting:
    """The split of the releases, where they agree on one."""
    rules = {r.manifest["split"]["by"] for r in releases}
    objects: dict[str, str] = {}
    sizes: dict[int, str] = {}
    where: dict[str, set[str]] = {}
    shapes = {object_id: row["shape_sha256"] for object_id, row in parts.rows(ids).items()}
    agreed = len(rules) == 1
    for release in releases:
        for row in release.objects.select(["object_id", "split"]).to_pylist():
            if row["object_id"] in shapes:
                objects[row["object_id"]] = row["split"]
                where.setdefault(shapes[row["object_id"]], set()).add(row["split"])
        for size, split in release.manifest["split"].get("sizes", {}).items():
            agreed &= sizes.setdefault(int(size), split) == split
    if not agreed or any(len(splits) > 1 for splits in where.values()):
        raise NotUsable(
            "the releases are split differently: an object that trains in one tests in another; "
            "split the result anew with --split object, category or size"
        )
    about = {k: v for k, v in releases[0].manifest["split"].items() if k not in ("by", "sizes")}
    by = rules.pop()
    assert by == "size" or ALL not in objects.values()
    return Splitting(by, {i: objects[i] for i in ids}, sizes, about)


def _derived(releases: Sequence[Release], what: Rewriting) -> dict[str, Any]:
    found: dict[str, Any] = {
        "how": what.how,
        "of": [
            {"name": r.name, "version": r.version, "manifest_sha256": sha256_of(r.path / MANIFEST)}
            for r in releases
        ],
        "whole_scenes": what.choose is None,
    }
    # A part of a part is no sample of anything, however the second part was chosen.
    found["whole_scenes"] &= all(
        r.manifest.get("derived", {}).get("whole_scenes", True) for r in releases
    )
    return {**found, **({"where": what.where} if what.where else {})}
