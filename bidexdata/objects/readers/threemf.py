"""3MF: meshes of the items to be built, with components and their transforms.

3MF has z up and says its unit. The parts of the archive are unpacked piece by piece under a bound
and parsed as they come; components are counted before any is copied.
"""

from __future__ import annotations

import io
import posixpath
import zipfile
import zlib
from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

from .content import Content, Part, check_faces, joined_parts, unreadable
from .inside import leads_out
from .scene import Place, placed

_METRES = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
_ROOT = "3d/3dmodel.model"
_BLOCK = 1 << 18
"""Bytes unpacked at a time."""

_Key = tuple[str, str]
"""An object: name of its part of the archive in lower case, id."""


def read_3mf(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read a 3MF file.

    Raises:
        PrepareFailure: It is no 3MF, is damaged, or unpacks to more than the bounds.
    """
    archive = _Archive(data, config)
    root = archive.model(archive.root)
    used = {archive.root: root}

    def children(key: _Key) -> Iterable[Place]:
        if key[0] not in used:
            used[key[0]] = archive.model(key[0])
        thing = used[key[0]].objects.get(key[1])
        if thing is None:
            raise unreadable(f"it builds the object {key[1]!r}, which does not exist")
        own = [Place((*key, "mesh"), np.eye(4))] if thing.triangles else []
        return own + [Place(c, T) for c, T in thing.components]

    shown = placed(
        [Place(key, T) for key, T in root.items], children, lambda key: len(key) == 3, config
    )
    meshes: dict[Any, Part] = {s.node: used[s.node[0]].objects[s.node[1]].part() for s in shown}
    check_faces(sum(len(meshes[s.node].faces) for s in shown), config)
    parts = [meshes[s.node]._replace(T_world_part=s.T) for s in shown]
    metres = _METRES.get(root.unit, 1e-3)
    return Content(joined_parts(parts, config), np.eye(3), metres, archive.warnings)


class _Object:
    """One object of a model: triangles, or other objects."""

    def __init__(self):
        self.vertices, self.triangles = array("d"), array("q")
        self.components: list[tuple[_Key, NDArray[np.float64]]] = []

    def part(self) -> Part:
        return Part(
            np.frombuffer(self.vertices, np.float64).reshape(-1, 3),
            np.frombuffer(self.triangles, np.int64).reshape(-1, 3),
        )


class _Archive:
    """The models of a 3MF archive, each parsed when asked for."""

    def __init__(self, data: bytes, config: LoadConfig):
        self._config, self._left = config, config.max_unpacked_bytes
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
            names = self._zip.namelist()
        except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError) as err:
            raise unreadable(f"it is no ZIP archive ({err})") from err
        self._names = {_plain(n): n for n in reversed(names)}
        stray = [n for n in names if leads_out(n.encode(errors="replace"))]
        self.warnings = tuple(
            f"its archive holds {n[:60]!r}, which leads out of it: nothing was unpacked there"
            for n in stray[:1]
        )
        models = [n for n in self._names if n.endswith(".model")]
        if not models:
            raise unreadable("the archive holds no 3D model")
        self.root = _ROOT if _ROOT in models else sorted(models)[0]

    def model(self, name: str) -> _Model:
        if name not in self._names:
            raise unreadable(f"it names the part {name[:60]!r}, which the archive does not hold")
        model = _Model(name, self._config)
        try:
            with self._zip.open(self._names[name]) as stream:
                while block := stream.read(min(_BLOCK, self._left + 1)):
                    self._left -= len(block)
                    if self._left < 0:
                        raise PrepareFailure(
                            Status.TOO_COMPLEX,
                            "it unpacks to more than load.max_unpacked_bytes = "
                            f"{self._config.max_unpacked_bytes} bytes",
                        )
                    model.feed(block)
            model.end()
        except (expat.ExpatError, LookupError) as err:  # the latter for unknown encodings
            raise unreadable(f"its XML cannot be read: {err}") from err
        except (
            zipfile.BadZipFile,
            zlib.error,
            EOFError,
            NotImplementedError,
            RuntimeError,
            OSError,
            ValueError,
        ) as err:
            raise unreadable(f"its archive is damaged ({err})") from err
        return model


class _Model:
    """What one model part says, gathered while its XML is read."""

    def __init__(self, name: str, config: LoadConfig):
        self.unit = "millimeter"
        self.objects: dict[str, _Object] = {}
        self.items: list[tuple[_Key, NDArray[np.float64]]] = []
        self._name, self._config = name, config
        self._current = _Object()
        self._started = False
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._element
        self._parser.EntityDeclHandler = _refuse_entities
        self._handlers = {
            "vertex": self._vertex,
            "triangle": self._triangle,
            "component": self._component,
            "item": self._item,
            "object": self._object,
            "model": self._model,
        }

    def feed(self, block: bytes) -> None:
        if not self._started and not block.lstrip(b" \t\r\n\0\xef\xbb\xbf\xff\xfe").startswith(
            b"<"
        ):
            raise unreadable("its model part is no XML")
        self._started = True
        self._parser.Parse(block, False)

    def end(self) -> None:
        self._parser.Parse(b"", True)

    def _element(self, tag: str, attributes: dict[str, str]) -> None:
        handler = self._handlers.get(tag.rpartition(":")[2])
        if handler is None:
            return
        try:
            handler(attributes)
        except (KeyError, ValueError, OverflowError) as err:
            line = self._parser.CurrentLineNumber
            raise unreadable(f"<{tag[:30]}> in line {line} makes no sense ({err})") from err

    def _model(self, attributes: dict[str, str]) -> None:
        self.unit = attributes.get("unit", self.unit)

    def _object(self, attributes: dict[str, str]) -> None:
        self._current = self.objects.setdefault(attributes["id"], _Object())

    def _vertex(self, attributes: dict[str, str]) -> None:
        self._current.vertices.extend(
            (float(attributes["x"]), float(attributes["y"]), float(attributes["z"]))
        )

    def _triangle(self, attributes: dict[str, str]) -> None:
        self._current.triangles.extend(
            (int(attributes["v1"]), int(attributes["v2"]), int(attributes["v3"]))
        )
        if len(self._current.triangles) > 3 * self._config.max_faces:
            check_faces(len(self._current.triangles) // 3, self._config)

    def _component(self, attributes: dict[str, str]) -> None:
        self._current.components.append((self._key(attributes), _transform(attributes)))

    def _item(self, attributes: dict[str, str]) -> None:
        self.items.append((self._key(attributes), _transform(attributes)))

    def _key(self, attributes: dict[str, str]) -> _Key:
        # The production extension names objects of other parts by an attribute `path`.
        path = next((v for k, v in attributes.items() if k.rpartition(":")[2] == "path"), None)
        return (self._name if path is None else _plain(path)), attributes["objectid"]


def _refuse_entities(*_: object) -> None:
    raise unreadable("it declares XML entities, which are not read")


def _plain(name: str) -> str:
    return posixpath.normpath("/" + name.replace("\\", "/")).strip("/").lower()


def _transform(attributes: dict[str, str]) -> NDArray[np.float64]:
    """4x4 matrix of twelve numbers; 3MF writes row vectors, rotation first."""
    T = np.eye(4)
    text = attributes.get("transform")
    if text is not None:
        rows = np.array([float(x) for x in text.split()]).reshape(4, 3)
        T[:3] = rows.T
    return T
