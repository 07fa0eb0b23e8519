"""The laws of figures: all of them counted again from the rows, and the card written again.

The tables say which runs a scene's rows are of, but not which run made the attempts of a scene
without rows, nor whether a test was run on an object without rows. Where that is open, what hangs
on it (the rates `unselected`) is left out, and the text says so.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.errors import Contradiction
from bidexdata.formats.card import write_card
from bidexdata.formats.citation import About
from bidexdata.formats.figures import Tally
from bidexdata.formats.pages import write_pages
from bidexdata.formats.rig_files import RIGS
from bidexdata.formats.stored_rows import StoredRows
from bidexdata.record.batch import SCHEMA_VERSION
from bidexdata.record.fields import METRICS, TESTS
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.release import Release

RELATIVE = 1e-6
"""Means and intervals may differ by this fraction: another processor rounds sums otherwise."""
DIVERSITY = 2e-6
"""D may differ by this: it is stored with six decimals."""
_NOT_OF_HEAD = ("format", "files")


def figures(release: Release) -> str:
    """Count every figure of every protocol again and compare key by key."""
    tallies, rows = _tallies(release), StoredRows(release, contacts=False)
    for object_id in rows.object_ids:
        for part in rows.rows_of(object_id):
            for name, tally in tallies.items():
                verdicts = {t: v for (p, t), v in part.verdicts.items() if p == name}
                tally.add(part.batch, verdicts, run=part.run, grasps=rows.wanted[part.run])
    ours = made_here(release)
    stated = {release.default_protocol: release.figures, **release.other_figures}
    compared, left_out = 0, 0
    for protocol, tally in tallies.items():
        if protocol not in stated:
            continue  # an older release states the default protocol's alone
        pairs = list(_leaves(stated[protocol], tally.figures(), protocol, ours))
        for path, said, found in pairs:
            if rows.unsure and "unselected" in path:
                left_out += 1
            elif (ours or _is_count(said)) and not _same(path, said, found):
                raise Contradiction(
                    f"figure {path} is {said!r} in the manifest, the rows give {found!r}"
                )
            else:
                compared += 1
    text = f"{counted(compared, 'figure')} of {counted(len(stated), 'protocol')} counted again"
    if not ours:
        text += (
            f", of which counts alone were compared, for bidexdata {_version(release)} made them"
        )
    if left_out:
        text += f"; {left_out} of unselected rates left out, for the runs of scenes without rows are not told"
    return text


def card(release: Release) -> str:
    """Write card and README again from the manifest and the tables and compare byte by byte."""
    return _written_again(release, write_card)


def pages(release: Release) -> str:
    """The same of all pages; Croissant holds the hashes of the tables."""
    return _written_again(release, lambda root, head: write_pages(root, head, About.of(head)))


def _written_again(release: Release, write: Callable[[Path, dict[str, Any]], Any]) -> str:
    if not made_here(release):
        return f"not written again, for bidexdata {_version(release)} wrote it"
    head = {k: v for k, v in release.manifest.items() if k not in _NOT_OF_HEAD}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        _link_tables(release.path, root)
        write(root, head | {"figures": in_order(head["figures"])})
        written = [p for p in sorted(root.rglob("*")) if p.is_file() and not p.is_symlink()]
        for path in written:
            name = path.relative_to(root).as_posix()
            stored = release.path / name
            if not stored.is_file() or stored.read_bytes() != path.read_bytes():
                raise Contradiction(f"{name} is not what the figures and tables give")
        return f"{', '.join(p.relative_to(root).as_posix() for p in written)} written again alike"


def in_order(figures: Any) -> Any:
    """Put keys in the order of the tally; the manifest's JSON sorts them as text."""
    if not isinstance(figures, Mapping):
        return figures
    keys = list(figures)
    for known in (METRICS, TESTS):
        if keys and set(keys) <= set(known):
            keys.sort(key=known.index)
    if all(key.isdecimal() for key in keys):
        keys.sort(key=int)
    return {key: in_order(figures[key]) for key in keys}


def made_here(release: Release) -> bool:
    """Whether this version of the package wrote the release, in this version's schema."""
    from bidexdata import __version__

    schema = release.header.schema_version
    return (_version(release), schema) == (__version__, SCHEMA_VERSION)


def _version(release: Release) -> str:
    return str(release.manifest.get("generator", {}).get("version", "of an unknown version"))


def _link_tables(source: Path, root: Path) -> None:
    # What the pages are written from, and nothing that is written here: that must not reach the
    # release.
    for path in sorted([*source.rglob("*.parquet"), *source.glob(f"{RIGS}/*/rig.json")]):
        link = root / path.relative_to(source)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(path.resolve())


def _tallies(release: Release) -> dict[str, Tally]:
    """One tally per protocol, as the writer has them."""
    tests = release.protocols
    names = sorted({release.default_protocol, *(p for p, _ in tests)})
    return {name: Tally(tuple(t for t in TESTS if (name, t) in tests) or ("f",)) for name in names}


def _leaves(stated: Any, found: Any, path: str, ours: bool) -> Iterator[tuple[str, Any, Any]]:
    """Pairs of equal keys; a key that one side lacks is a pair with None where we wrote both."""
    if isinstance(stated, Mapping) and isinstance(found, Mapping):
        for key in sorted({*stated, *found}):
            if (key in stated and key in found) or ours:
                yield from _leaves(stated.get(key), found.get(key), f"{path}.{key}", ours)
    else:
        yield path, stated, found


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _same(path: str, stated: Any, found: Any) -> bool:
    if isinstance(stated, float) and isinstance(found, float | int):
        rounded = path.rsplit(".", 1)[-1] in ("d", "d_scale_free", "d_audit")
        return math.isclose(
            stated, found, rel_tol=RELATIVE, abs_tol=DIVERSITY if rounded else 1e-12
        )
    return type(stated) is type(found) and stated == found
