"""The manifest of a release: sha256 of every file, covered itself by `manifest.sha256`.

`manifest.json` is canonical JSON; `manifest.sha256` is one line that `sha256sum -c` understands.
Together they cover every byte of the folder, so any flipped bit and any stray file is found.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bidexdata.config import canonical_json
from bidexdata.errors import Contradiction
from bidexdata.kinds import MANIFEST

MANIFEST_HASH = "manifest.sha256"
FORMAT = "bidexdata-release"
OF_THE_HUB = (".gitattributes", ".cache")
"""At the top of a folder that Hugging Face's client downloaded; not files of the release."""


def sha256_of(path: Path) -> str:
    """Hash a file in blocks."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_all(paths: Sequence[Path]) -> list[str]:
    """Hash files on all cores, in order: hashing leaves the interpreter's lock free."""
    known = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if known else os.cpu_count()
    with ThreadPoolExecutor(cores or 1) as pool:
        return list(pool.map(sha256_of, paths))


def write_manifest(
    root: Path, head: Mapping[str, Any], rows: Mapping[str, int] | None = None
) -> dict[str, Any]:
    """Hash every file under `root` and write manifest and manifest hash.

    Args:
        root: Release folder, complete but for the two manifest files.
        head: Names, versions and figures; `format` and `files` are added.
        rows: Number of rows of the files of row tables, by name.

    Returns:
        The manifest as written.
    """
    names = sorted(list_files(root))
    hashes = sha256_of_all([root / name for name in names])
    files: dict[str, dict[str, Any]] = {
        name: {"bytes": (root / name).stat().st_size, "sha256": digest}
        for name, digest in zip(names, hashes, strict=True)
    }
    for name, count in (rows or {}).items():
        files[name]["rows"] = count
    manifest = {**head, "format": FORMAT, "files": files}
    text = (canonical_json(manifest) + "\n").encode()
    (root / MANIFEST).write_bytes(text)
    (root / MANIFEST_HASH).write_bytes(_hash_line(text))
    return manifest


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest after checking it against `manifest.sha256`.

    Raises:
        Contradiction: A manifest file is missing, damaged, or no manifest of a release.
    """
    try:
        text, line = (root / MANIFEST).read_bytes(), (root / MANIFEST_HASH).read_bytes()
    except OSError as err:
        raise Contradiction(f"{root}: unreadable manifest ({err.strerror})") from err
    if line != _hash_line(text):
        raise Contradiction(f"{root}: {MANIFEST} does not match {MANIFEST_HASH}; one is damaged")
    try:
        manifest = json.loads(text)
        assert_is = manifest["format"] == FORMAT and isinstance(manifest["files"], dict)
    except (ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{root / MANIFEST}: not a manifest of a release ({err!r})") from err
    if not assert_is:
        raise Contradiction(f"{root / MANIFEST}: not a manifest of a bidexdata release")
    return manifest


def list_files(root: Path) -> Iterator[str]:
    """Name everything under `root` that is not a plain folder, manifest files left out.

    What the hub's client leaves beside a download is left out too, so that a release can be
    verified where it was downloaded to.

    Links are named, not followed; an empty folder is named with a trailing slash, because a
    release that was written has none.
    """
    for folder, folders, files in os.walk(root):
        here = Path(folder).relative_to(root)
        if here == Path():
            for names in (folders, files):
                names[:] = [n for n in names if n not in OF_THE_HUB]
        for name in [*files, *(f for f in folders if (Path(folder) / f).is_symlink())]:
            path = (here / name).as_posix()
            if path not in (MANIFEST, MANIFEST_HASH):
                yield path
        if not files and not folders and here != Path():
            yield here.as_posix() + "/"


def damage(root: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Compare the folder with its manifest; one sentence per missing, changed or extra file."""
    listed, present = manifest["files"], set(list_files(root))
    found = [f"{name} is missing" for name in sorted(set(listed) - present)]
    found += [f"{name} is not in the manifest" for name in sorted(present - set(listed))]
    whole = []
    for name in sorted(set(listed) & present):
        path = root / name
        if path.is_symlink() or not path.is_file():
            found.append(f"{name} is not a plain file")
        elif path.stat().st_size != listed[name]["bytes"]:
            size = path.stat().st_size
            found.append(f"{name} has {size} bytes, the manifest says {listed[name]['bytes']}")
        else:
            whole.append(name)
    for name, digest in zip(whole, sha256_of_all([root / n for n in whole]), strict=True):
        if digest != listed[name]["sha256"]:
            found.append(f"{name} does not match its sha256")
    return found


def _hash_line(text: bytes) -> bytes:
    return f"{hashlib.sha256(text).hexdigest()}  {MANIFEST}\n".encode()
