"""Objects of Objaverse 1.0, through the package `objaverse` and its download cache.

`objaverse:uids=FILE` takes the objects of a list, `objaverse:lvis=CATEGORY` those of an LVIS
category, `objaverse:random=N,seed=K` N of all, or of a category where `lvis=` stands beside it.
Listing needs the collection's index only; files and annotations are fetched for the objects that
are wanted in the end, and what the cache holds is not fetched again.
"""

from __future__ import annotations

import hashlib
import os
import sys
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar
from urllib.error import HTTPError

from bidexdata.errors import BadValue, MissingExtra, NotUsable, PathNotFound, UnknownName

from .item import UNKNOWN, SourceItem
from .lists import text_lines

_FORM = "objaverse:uids=FILE, objaverse:lvis=CATEGORY or objaverse:random=N[,seed=K]"
_KEYS = ("uids", "lvis", "random", "seed")
_COLLECTION = "Objaverse 1.0"
_SPDX = {
    "by": "CC-BY-4.0",
    "by-nc": "CC-BY-NC-4.0",
    "by-nc-nd": "CC-BY-NC-ND-4.0",
    "by-nc-sa": "CC-BY-NC-SA-4.0",
    "by-nd": "CC-BY-ND-4.0",
    "by-sa": "CC-BY-SA-4.0",
    "cc0": "CC0-1.0",
}
"""The annotations' words for Creative Commons licences; anything else is kept as it is.
Source: Objaverse 1.0, whose models are Sketchfab's under version 4.0 of these licences."""
_T = TypeVar("_T")


def objaverse_items(request: str) -> list[SourceItem]:
    """Inputs for `objaverse:<request>`, without files and licences yet: see `fetched`.

    A list keeps its order; a category and a random choice come in byte order of the uids. The
    choice depends on the seed and the uids alone, and a smaller one is part of a larger one.

    Raises:
        BadValue: The request is malformed.
        PathNotFound: The list does not exist.
        UnknownName: No LVIS category is called so.
        MissingExtra: The package `objaverse` is not installed.
        NotUsable: The collection's index is not in the cache and cannot be downloaded.
    """
    wanted = _parsed(request)
    if "uids" in wanted:
        return [_item(uid) for uid in _listed(Path(wanted["uids"]))]
    package, category = _package(), wanted.get("lvis", "")
    if category:
        uids = _of_category(_asked("its LVIS categories", package.load_lvis_annotations), category)
    else:
        uids = _asked("its list of objects", package.load_uids)
    uids = sorted(set(uids))
    if "random" in wanted:
        uids = sorted(_chosen(uids, int(wanted["random"]), int(wanted.get("seed", 0))))
    return [_item(uid, category) for uid in uids]


def fetched(items: Sequence[SourceItem]) -> list[SourceItem]:
    """Fill in files, licences and authors of the inputs that are Objaverse's, downloading the rest.

    An object that Objaverse does not have, or no longer gives, gets a `problem`.

    Raises:
        MissingExtra: The package `objaverse` is not installed.
        NotUsable: Something is not in the cache and there is no connection.
    """
    uids = [item.uid for item in items if item.uid]
    if not uids:
        return list(items)
    package = _package()
    paths, problems = _files(package, uids)
    known = _asked("its annotations", lambda: package.load_annotations(list(paths)))
    return [
        _filled(item, paths, problems, known.get(item.uid, {})) if item.uid else item
        for item in items
    ]


def _parsed(request: str) -> dict[str, str]:
    """`key=value,...` as a dictionary of keys that go together."""
    pairs = [part.partition("=") for part in request.split(",") if part.strip()]
    wanted = {key.strip(): value.strip() for key, _, value in pairs}
    unknown = next((key for key in wanted if key not in _KEYS), None)
    if unknown is not None or not all(wanted.values()) or len(wanted) < len(pairs):
        raise BadValue(f"objaverse:{request}: write {_FORM}")
    mixed = "uids" in wanted and len(wanted) > 1
    if mixed or not wanted or ("seed" in wanted and "random" not in wanted):
        raise BadValue(f"objaverse:{request}: these do not go together; write {_FORM}")
    for key, least in (("random", 1), ("seed", 0)):
        value = wanted.get(key, "1")
        if not (value.isdecimal() and int(value) >= least):
            raise BadValue(f"objaverse:{request}: {key} must be a whole number from {least}")
    return wanted


def _listed(path: Path) -> list[str]:
    """The uids of a list, without the endings that file names have."""
    if not os.path.isfile(path):
        raise PathNotFound(path, "a text file with one Objaverse uid per line")
    uids = [Path(line).name.removesuffix(".glb") for line in text_lines(path)]
    if not uids:
        raise NotUsable(f"{path}: the list names no Objaverse uid; write one per line")
    return list(dict.fromkeys(uids))


def _of_category(categories: Mapping[str, list[str]], name: str) -> list[str]:
    if name not in categories:
        near = get_close_matches(name, categories, n=5, cutoff=0.5) or sorted(categories)[:5]
        raise UnknownName("LVIS category", name, near, f"{len(categories) - len(near)} others")
    return categories[name]


def _chosen(uids: Sequence[str], count: int, seed: int) -> list[str]:
    """Order by a hash of seed and uid: the same whatever the order, machine and version."""
    return sorted(uids, key=lambda uid: hashlib.sha256(f"{seed}/{uid}".encode()).digest())[:count]


def _item(uid: str, category: str = UNKNOWN) -> SourceItem:
    return SourceItem(
        source_name=f"objaverse:{uid}",
        uid=uid,
        source=_COLLECTION,
        category=category or UNKNOWN,
    )


def _filled(
    item: SourceItem,
    paths: Mapping[str, str],
    problems: Mapping[str, str],
    annotation: Mapping[str, Any],
) -> SourceItem:
    if item.uid not in paths:
        return replace(item, problem=problems.get(item.uid, f"{_COLLECTION} has no such object"))
    user = annotation.get("user") or {}
    licence = str(annotation.get("license") or UNKNOWN)
    named = [c.get("name") for c in annotation.get("categories") or [] if c.get("name")]
    category = item.category if item.category != UNKNOWN or not named else str(named[0])
    return replace(
        item,
        path=Path(paths[item.uid]),
        source=str(annotation.get("viewerUrl") or item.source),
        licence=_SPDX.get(licence, licence),
        author=str(user.get("displayName") or user.get("username") or UNKNOWN),
        category=category,
    )


def _files(package: Any, uids: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Where the files of the objects are, and why others have none."""
    try:
        return _asked("objects", lambda: package.load_objects(uids), refusals=True), {}
    except HTTPError:
        pass  # one that the server refuses must not cost the others
    paths: dict[str, str] = {}
    problems: dict[str, str] = {}
    for uid in uids:
        try:
            paths |= _asked("objects", lambda uid=uid: package.load_objects([uid]), refusals=True)
        except HTTPError as err:
            problems[uid] = f"it cannot be downloaded: HTTP {err.code} {err.reason}"
    return paths, problems


def _asked(what: str, call: Callable[[], _T], *, refusals: bool = False) -> _T:
    """Ask the package, which prints and warns; what it prints must not reach standard output.

    `refusals` lets a server's refusal of one file through.
    """
    try:
        with redirect_stdout(sys.stderr), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an unknown uid becomes a row
            return call()
    except (OSError, EOFError, ValueError, zlib.error) as err:
        if refusals and isinstance(err, HTTPError):
            raise
        text = str(getattr(err, "reason", "") or err) or type(err).__name__
        raise NotUsable(
            f"objaverse: {what} cannot be read from the download cache or fetched ({text}); "
            "the same command goes on once there is a connection"
        ) from err


def _package() -> Any:
    try:
        import objaverse
    except ImportError as err:
        raise MissingExtra("objaverse", "objaverse") from err
    return objaverse
