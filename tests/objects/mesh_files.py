"""Mesh files written byte by byte, so that tests know what is in them."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np

from bidexdata.objects.glb import write_glb
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.runs.library_report import TIMES


def write_stl(path: Path, mesh: TriangleMesh) -> Path:
    """Write a binary STL; every corner is its own vertex, as the format has it."""
    record = np.zeros(len(mesh.faces), [("n", "<f4", 3), ("t", "<f4", (3, 3)), ("a", "<u2")])
    record["t"] = mesh.vertices[mesh.faces]
    path.write_bytes(b" " * 80 + len(mesh.faces).to_bytes(4, "little") + record.tobytes())
    return path


def write_obj(path: Path, mesh: TriangleMesh) -> Path:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_gltf(path: Path, mesh: TriangleMesh, buffer: str = "") -> Path:
    """Write a text glTF; its numbers go into the file `buffer` beside it, or into a data URI."""
    data = write_glb(mesh)
    end = 20 + int.from_bytes(data[12:16], "little")
    document, numbers = json.loads(data[20:end]), data[end + 8 :]
    uri = "data:application/octet-stream;base64," + base64.b64encode(numbers).decode()
    if buffer:
        (path.parent / buffer).write_bytes(numbers)
    document["buffers"][0]["uri"] = buffer or uri
    for accessor in document["accessors"]:  # else the text would tell one shape from another
        accessor.pop("min", None)
        accessor.pop("max", None)
    path.write_text(json.dumps(document))
    return path


def library_files(library: Path) -> dict[str, bytes]:
    """All files of a library but the times, which differ from run to run."""
    found = (p for p in library.rglob("*") if p.is_file() and TIMES not in p.parts)
    return {p.relative_to(library).as_posix(): p.read_bytes() for p in found}


def mixed_folder(folder: Path, mesh: TriangleMesh) -> Path:
    """A good file, the same bytes again, points without faces, half an STL, and a good one again."""
    folder.mkdir()
    good = write_stl(folder / "a_box.stl", mesh)
    (folder / "b_copy.stl").write_bytes(good.read_bytes())
    (folder / "c_points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (folder / "d_half.stl").write_bytes(good.read_bytes()[:300])
    write_obj(folder / "e_box.obj", mesh)
    return folder
