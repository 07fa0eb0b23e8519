"""`croissant.json`: what a release holds, for data set search and for loaders (Croissant 1.1).

Fields are generated from the field tables; every Parquet file stands with its sha256. The file is
written after the tables and before the manifest, which covers it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bidexdata.formats.citation import About
from bidexdata.formats.columns import Column, release_columns
from bidexdata.formats.licences import licence_address
from bidexdata.formats.manifest import sha256_of
from bidexdata.formats.tables import CONFIGURATIONS, folder_of
from bidexdata.record import Header

CROISSANT = "croissant.json"
PARQUET = "application/x-parquet"
_TYPES = {
    "string": "sc:Text",
    "bool": "sc:Boolean",
    "float32": "cr:Float32",
    "float64": "cr:Float64",
    "int8": "cr:Int8",
    "int16": "cr:Int16",
    "int32": "cr:Int32",
    "int64": "cr:Int64",
}
_PLAIN = ("objects", "scenes", "runs")
_KEYS = {"objects": "object_id", "scenes": "scene_id", "runs": "run"}

# fmt: off
_CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape", "citeAs": "cr:citeAs", "column": "cr:column",
    "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/", "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"}, "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract",
    "field": "cr:field", "fileObject": "cr:fileObject", "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet", "format": "cr:format", "includes": "cr:includes",
    "isArray": "cr:isArray", "isLiveDataset": "cr:isLiveDataset", "jsonPath": "cr:jsonPath",
    "key": "cr:key", "md5": "cr:md5", "name": {"@container": "@language"},
    "parentField": "cr:parentField", "path": "cr:path", "recordSet": "cr:recordSet",
    "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "sc": "https://schema.org/",
    "separator": "cr:separator", "source": "cr:source", "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The official context, whole: validators warn of any other."""
# fmt: on


def write_croissant(
    root: Path, head: Mapping[str, Any], about: About, licences: Iterable[str]
) -> None:
    """Write `croissant.json` into a release folder.

    Args:
        root: Folder whose tables are complete.
        head: The manifest's head (see `writer.write_release`).
        about: Creators, date and address.
        licences: SPDX identifiers of the objects.
    """
    header = Header.from_json(head["header"])
    tests = [(p, t) for p, t in head["tests"]]
    columns = release_columns(header, tests)
    files, records = _tables(root, columns)
    addresses = sorted({licence_address(x) for x in licences} - {""})
    data: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": head["name"],
        "description": _description(head, header),
        "version": head["version"],
        "creator": [_creator(c) for c in about.creators(head["name"])],
        "citeAs": _cite_as(head, about),
        "keywords": ["dexterous grasping", "robotics", "bidexdata"],
        "isLiveDataset": False,
    }
    if addresses:
        data["license"] = addresses
    if about.date:
        data["datePublished"] = about.date
    if about.url:
        data["url"] = about.url
    data |= {"distribution": files, "recordSet": records}
    text = json.dumps(data, indent=1, ensure_ascii=False)
    (root / CROISSANT).write_text(text + "\n", encoding="utf-8")


def _tables(
    root: Path, columns: Mapping[str, Sequence[Column]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Files and record sets of every table that has Parquet files."""
    files, records = [], []
    for table in _PLAIN:
        files.append(_file(root, f"{table}.parquet"))
        records.append(_record_set(table, f"{table}.parquet", "fileObject", columns[table]))
    for table in (t for t in columns if t not in _PLAIN):
        for configuration in CONFIGURATIONS:
            folder = folder_of(table, configuration)
            parts = sorted(p.name for p in (root / folder).glob("*.parquet"))
            if not parts:
                continue
            name = configuration if table == "grasps" else folder.replace("/", "-")
            files += [_file(root, f"{folder}/{part}") for part in parts]
            files.append(
                {
                    "@type": "cr:FileSet",
                    "@id": f"{name}-files",
                    "name": f"{name}-files",
                    "description": f"{len(parts)} files of {folder}, each listed with its sha256",
                    "encodingFormat": PARQUET,
                    "includes": f"{folder}/*.parquet",
                }
            )
            records.append(_record_set(name, f"{name}-files", "fileSet", columns[table]))
    return files, records


def _file(root: Path, name: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{(root / name).stat().st_size} B",
        "encodingFormat": PARQUET,
        "sha256": sha256_of(root / name),
    }


def _record_set(name: str, source: str, kind: str, columns: Sequence[Column]) -> dict[str, Any]:
    key = _KEYS.get(name, "grasp_id")
    fields = [_field(name, {kind: {"@id": source}}, column) for column in columns]
    if kind == "fileSet":
        fields.append(_split_field(name, source))
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "key": {"@id": f"{name}/{key}"},
        "field": fields,
    }


def _field(record: str, source: Mapping[str, Any], column: Column) -> dict[str, Any]:
    array = {"isArray": True, "arrayShape": str(column.width)} if column.width else {}
    return {
        "@type": "cr:Field",
        "@id": f"{record}/{column.name}",
        "name": column.name,
        "description": column.words(),
        "dataType": _TYPES[column.dtype],
        **array,
        "source": {**source, "extract": {"column": column.name}},
    }


def _split_field(record: str, source: str) -> dict[str, Any]:
    """The split of a row, from the name of its file."""
    return {
        "@type": "cr:Field",
        "@id": f"{record}/split",
        "name": "split",
        "description": "split of the row, from the name of its file",
        "dataType": "sc:Text",
        "source": {
            "fileSet": {"@id": source},
            "extract": {"fileProperty": "filename"},
            "transform": {"regex": "^([a-z]+)-.*\\.parquet$"},
        },
    }


def _description(head: Mapping[str, Any], header: Header) -> str:
    figures = head["figures"]
    hands = ", ".join(f"{h.name} {h.side}" for h in header.hands)
    return (
        f"Dexterous grasps ({hands}): {figures['selected_rows']} selected rows of "
        f"{figures['objects']} objects in {figures['scenes']} scenes, and {figures['audit_rows']} "
        "audit rows, which were drawn before any filter. Lengths are metres, angles radians, "
        f"quaternions wxyz. Success is that of protocol {head['default_protocol']}."
    )


def _creator(person: Mapping[str, str]) -> dict[str, str]:
    if "name" in person:
        return {"@type": "sc:Organization", "name": person["name"]}
    name = f"{person['given-names']} {person['family-names']}"
    return {"@type": "sc:Person", "name": name}


def _cite_as(head: Mapping[str, Any], about: About) -> str:
    names = "; ".join(about.authors) or f"The authors of {head['name']}"
    year = f" ({about.date[:4]})" if about.date else ""
    address = f" {about.url}" if about.url else ""
    return f"{names}{year}: {head['name']}, version {head['version']}.{address}"
