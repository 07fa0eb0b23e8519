"""One triangle mesh as binary glTF and back, the same bytes every time.

Our axes have z up, glTF has y up: the file's only node turns by a quarter, so that any viewer
shows the object upright while the stored coordinates are those of the object frame.
"""

from __future__ import annotations

import json
import struct

import numpy as np

from bidexdata.errors import Contradiction

from .prepared import TriangleMesh

_FLOAT, _UNSIGNED = 5126, 5125
_HALF = float(np.sqrt(0.5))


def write_glb(mesh: TriangleMesh) -> bytes:
    """Write vertices as float32 and faces as uint32."""
    vertices = np.ascontiguousarray(mesh.vertices, "<f4")
    indices = np.ascontiguousarray(mesh.faces, "<u4")
    blob = vertices.tobytes() + indices.tobytes()
    document = {
        "asset": {"version": "2.0", "generator": "bidexdata"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [-_HALF, 0.0, 0.0, _HALF]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": _FLOAT,
                "count": len(vertices),
                "type": "VEC3",
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {
                "bufferView": 1,
                "componentType": _UNSIGNED,
                "count": indices.size,
                "type": "SCALAR",
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": vertices.nbytes},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": indices.nbytes},
        ],
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def read_glb(data: bytes, where: str) -> TriangleMesh:
    """Read a mesh that `write_glb` wrote, in the object frame.

    Args:
        data: The file's bytes.
        where: How messages name the file.

    Raises:
        Contradiction: The bytes are not such a file.
    """
    try:
        magic, _, total = struct.unpack("<4sII", data[:12])
        length = struct.unpack("<I", data[12:16])[0]
        document = json.loads(data[20 : 20 + length])
        start = 20 + length + 8
        positions, indices = document["accessors"]
        split = start + 12 * positions["count"]
        vertices = np.frombuffer(data[start:split], "<f4").reshape(-1, 3)
        faces = np.frombuffer(data[split : split + 4 * indices["count"]], "<u4").reshape(-1, 3)
        good = magic == b"glTF" and total == len(data) and len(faces) * 3 == indices["count"]
    except (struct.error, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{where} is damaged ({type(err).__name__})") from err
    if not good or (len(faces) and faces.max() >= len(vertices)):
        raise Contradiction(f"{where} is damaged (its counts do not fit)")
    return TriangleMesh(vertices.astype(np.float64), faces.astype(np.int32))
