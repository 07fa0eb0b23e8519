"""Valid files of every format, and seeded damage to them: the material of the fuzz tests."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

FORMATS = ("3mf", "dae", "glb", "gltf", "obj", "off", "ply", "stl")


def valid_files(folder: Path, meshes: list[Any], count: int) -> dict[str, list[bytes]]:
    """Files of each format: those of the folder, then the meshes as trimesh writes them.

    A format that this installation cannot write is left out where the folder has none.
    """
    found: dict[str, list[bytes]] = {}
    for form in FORMATS:
        files = [p.read_bytes() for p in sorted(folder.glob(f"*.{form}"))[:count]]
        files += [d for m in meshes[: count - len(files)] if (d := exported(m, form))]
        if files:
            found[form] = files
    return found


def exported(mesh: Any, form: str) -> bytes:
    """A mesh as a file of one format; empty where a package for it is missing."""
    import trimesh

    try:
        if form == "gltf":
            return trimesh.Scene(mesh).export(file_type="gltf", embed_buffers=True)["model.gltf"]
        data = mesh.export(file_type=form)
    except ImportError:
        return b""
    return data.encode() if isinstance(data, str) else data


def damaged(data: bytes, rng: np.random.Generator, form: str) -> Iterator[bytes]:
    """Endless variants: cut, single bytes, runs, blocks that move, numbers of text that change.

    An archive is damaged inside as often as outside: its checksums would catch the rest.
    """
    while True:
        if form == "3mf" and rng.random() < 0.5:
            yield _inside(data, rng)
        else:
            yield _hurt(data, rng)


def _hurt(data: bytes, rng: np.random.Generator) -> bytes:
    way = rng.integers(5)
    bytes_ = bytearray(data)
    size = len(bytes_)
    if way == 0:
        return bytes(bytes_[: rng.integers(size)])
    if way == 1:
        # Headers are short and matter most: half of the damage goes there.
        limit = min(size, 400) if rng.random() < 0.5 else size
        for place in rng.integers(0, limit, rng.integers(1, 12)):
            bytes_[place] ^= 1 << rng.integers(8)
    elif way == 2:
        start = int(rng.integers(size))
        length = int(rng.integers(1, 64))
        bytes_[start : start + length] = rng.integers(0, 256, length, np.uint8).tobytes()
    elif way == 3:
        a, b = sorted(rng.integers(0, size, 2))
        return bytes(bytes_[:a] + bytes_[b:] + bytes_[a:b])
    else:
        digits = [k for k in range(min(size, 20_000)) if 48 <= bytes_[k] < 58]
        for place in rng.choice(digits, min(len(digits), 3)) if digits else ():
            new = rng.choice([b"9", b"-", b"e", b"999999999999", b"0", b" "])
            bytes_[place : place + 1] = new
    return bytes(bytes_)


def _inside(data: bytes, rng: np.random.Generator) -> bytes:
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(data)) as old,
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, _hurt(content, rng) if name.endswith(".model") else content)
    return buffer.getvalue()
