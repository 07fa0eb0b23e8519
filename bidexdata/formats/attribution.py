"""ATTRIBUTION.md: whose objects a release has, under which licence, and where they are from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bidexdata.formats.licences import UNKNOWN, licence_address

ATTRIBUTION = "ATTRIBUTION.md"

_HEAD = """# Attribution: {name} {version}

The meshes of this data set are the work of others. They were changed: repaired, cut into convex
pieces and scaled to unit diagonal. {left_out}Where a licence asks for attribution, this table is it.
Where a source states no address, the collection that the mesh is from stands in its place; `unknown`
is what nobody stated.

| object | source file | author | licence | address or collection |
|---|---|---|---|---|
"""
_LEFT_OUT = "The meshes themselves are left out; objects are named and described only. "


def attribution_text(
    name: str, version: str, objects: Iterable[Mapping[str, Any]], *, shapes: bool
) -> str:
    """Contents of `ATTRIBUTION.md`.

    Args:
        name: Of the data set.
        version: Its version.
        objects: Rows of the objects table.
        shapes: Whether the release holds the meshes.
    """
    head = _HEAD.format(name=name, version=version, left_out="" if shapes else _LEFT_OUT)
    return head + "".join(_line(row) for row in objects)


def _line(row: Mapping[str, Any]) -> str:
    licence = str(row["licence"])
    address = licence_address(licence)
    cells = (
        f"`{row['object_id']}`",
        str(row["source_name"]),
        str(row["author"]),
        f"[{licence}]({address})" if address else licence,
        str(row.get("uri") or "") or str(row["source"]),
    )
    return "| " + " | ".join(_cell(c) for c in cells) + " |\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").strip() or UNKNOWN
