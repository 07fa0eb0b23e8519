"""Laws of the readers: what a format says of units, axes and transforms counts; what it claims does not."""

from __future__ import annotations

import io
import json
import os
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from mesh_files import write_obj, write_stl

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.glb import write_glb
from bidexdata.objects.physics import mass_properties, surface_area
from bidexdata.objects.polygons import triangulated
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.readers import SUFFIXES, Content, read_content
from bidexdata.objects.sources import resolve_sources
from bidexdata.objects.weld import weld
from bidexdata.record.status import Status

CONFIG = LoadConfig()
FLOAT32 = 1e-6
ELL = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], float)


def read(name: str, data: bytes | str, config: LoadConfig = CONFIG) -> Content:
    return read_content(Path(name), data if isinstance(data, bytes) else data.encode(), config)


def refused(name: str, data: bytes | str, config: LoadConfig = CONFIG) -> PrepareFailure:
    with pytest.raises(PrepareFailure) as caught:
        read(name, data, config)
    assert caught.value.reason
    return caught.value


def volume(content: Content) -> float:
    return mass_properties(weld(content.mesh, 1e-6)).volume


def of_lists(vertices: np.ndarray, polygons: list) -> np.ndarray:
    counts = np.array([len(p) for p in polygons], np.int64)
    return triangulated(vertices, np.array([k for p in polygons for k in p], np.int64), counts)


def prism() -> tuple[np.ndarray, list[list[int]]]:
    """An L of area 5, extruded by 2: concave hexagons and quads."""
    vertices = np.array([(x, y, z) for z in (0.0, 2.0) for x, y in ELL])
    sides = [[k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k] for k in range(6)]
    return vertices, [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *sides]


@pytest.mark.parametrize("turn", range(6))
@pytest.mark.parametrize("way", [1, -1])
def test_a_concave_polygon_is_covered_once(turn, way):
    vertices, _ = prism()
    polygon = list(np.roll(np.arange(6), turn)[::way])
    faces = of_lists(vertices, [polygon])
    assert len(faces) == 4
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)[:, 2] / 2
    assert area.sum() == pytest.approx(5 * way)
    assert np.abs(area).sum() == pytest.approx(5)


def test_polygons_keep_their_order_and_lines_give_nothing():
    vertices, _ = prism()
    faces = of_lists(vertices, [[0, 1, 2], [3, 4], [0, 1, 7, 6], [2, 3, 4]])
    assert faces.tolist() == [[0, 1, 2], [0, 1, 7], [0, 7, 6], [2, 3, 4]]
    assert of_lists(vertices, []).shape == (0, 3)


def obj_text(vertices, polygons) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join(lines + ["f " + " ".join(str(k + 1) for k in p) for p in polygons])


def off_text(vertices, polygons) -> str:
    lines = [f"{x} {y} {z}" for x, y, z in vertices]
    lines += [f"{len(p)} {' '.join(map(str, p))} 255 0 0" for p in polygons]
    return f"OFF{len(vertices)} {len(polygons)} 0 # counts\n" + "\n".join(lines)


def ply_data(vertices, polygons, form: str, strip: bool = False) -> bytes:
    """Polygons between two scalars, as scanners write them."""
    head = f"ply\nformat {form} 1.0\ncomment made\nelement vertex {len(vertices)}\n"
    head += "property double x\nproperty uchar red\nproperty double y\nproperty double z\n"
    if strip:
        head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        rows = [[-5]]
    else:
        head += f"element face {len(polygons)}\nproperty float quality\n"
        head += "property list uchar int vertex_indices\nproperty short flags\nend_header\n"
    if form == "ascii":
        rows = [f"{x} 9 {y} {z}" for x, y, z in vertices]
        if strip:
            rows.append(f"{len(polygons)} {' '.join(map(str, polygons))}")
        else:
            rows += [f"0.5 {len(p)} {' '.join(map(str, p))} 7" for p in polygons]
        return (head + "\n".join(rows) + "\n").encode()
    mark = ">" if "big" in form else "<"
    body = b"".join(struct.pack(mark + "dBdd", x, 9, y, z) for x, y, z in vertices)
    if strip:
        body += struct.pack(f"{mark}i{len(polygons)}i", len(polygons), *polygons)
    else:
        for p in polygons:
            body += struct.pack(f"{mark}fB{len(p)}ih", 0.5, len(p), *p, 7)
    return head.encode() + body


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("form", FORMS)
def test_a_ply_of_mixed_polygons_is_read_in_every_encoding(form):
    content = read("l.ply", ply_data(*prism(), form))
    assert volume(content) == pytest.approx(10)
    assert surface_area(content.mesh) == pytest.approx(2 * 5 + 12 * 2)
    even = [p for p in prism()[1] if len(p) == 4]
    assert len(read("l.ply", ply_data(prism()[0], even, form)).mesh.faces) == 12


@pytest.mark.parametrize("form", FORMS)
def test_ply_strips_alternate_and_begin_anew_at_minus_one(form):
    vertices = np.array([[k // 2, k % 2, 0] for k in range(8)], float)
    content = read("s.ply", ply_data(vertices, [0, 1, 2, 3, -1, 4, 5, 6, 7], form, strip=True))
    assert content.mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]


@pytest.mark.parametrize(("name", "text"), [("l.obj", obj_text), ("l.off", off_text)])
def test_text_formats_take_polygons(name, text):
    content = read(name, text(*prism()))
    assert volume(content) == pytest.approx(10)
    assert surface_area(content.mesh) == pytest.approx(34)
    assert content.metres_per_unit is None


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_text_is_read_in_the_encoding_of_its_mark(encoding):
    assert volume(read("l.obj", obj_text(*prism()).encode(encoding))) == pytest.approx(10)


def test_obj_takes_what_the_format_allows():
    text = """# made by hand
    v\t0 0 0 1 0.5 0.5
    v 1 0 0
    v 0 1 \\
      0
    vt 0 0
    f 1/1/1 -1 2//1 # turned
    v 0 0 1
    g next
    f -4 -3/2 -1
    """
    content = read("a.obj", text.replace("\n", "\r\n"))
    assert content.mesh.faces.tolist() == [[0, 2, 1], [0, 1, 3]]
    assert content.group is not None
    assert content.group.tolist() == [0, 1]


def test_every_triangle_of_an_obj_knows_its_group():
    points = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    text = f"o bare\n{points}o a\nf 1 2 3 4\nf 1 2\ng\nf 1 2 3\ng empty\no\nf 1 3 4\nf 2 3 4\n"
    content = read("a.obj", text)
    assert content.group is not None
    assert content.group.tolist() == [2, 2, 3, 5, 5]


LINES = {
    "v 0 0 0\nv 1 2\nf 1 2 1": "line 2",
    "v 0 0 0\nv 0,5 0 1\nf 1 2 1": "write a point",
    "v 0 0 0\n\nv 0 1 0\nf 1 2 2.5": "line 4",
    "v 0 0 0\nv 0 1 0\nf 1 2 1\nf 1 2 99999999999999999999": "line 4",
    "v 0 0 0\nv 0 1 0\nf 1 2 3": "names vertex 3 of 2",
    "v 0 0 0\nv 0 1 0\nf 1 2 -3": "names vertex -3 of 2",
    "v 0 0 0\nv 0 1 0\nf 1 2 0": "counts from 1",
}


@pytest.mark.parametrize("text", LINES)
def test_a_bad_line_of_an_obj_is_named(text):
    assert LINES[text] in refused("a.obj", text).reason


CUT = {
    "ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n1.5 22.5",
    "off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n",
}


@pytest.mark.parametrize("kind", CUT)
def test_a_file_that_is_cut_off_is_told_so(kind):
    assert "cut off" in refused(f"a.{kind}", CUT[kind]).reason


@pytest.mark.parametrize("claim", [10**6, 10**12, 10**30])
@pytest.mark.parametrize("form", FORMS)
def test_no_memory_is_asked_for_what_a_header_only_claims(form, claim):
    data = ply_data(*prism(), form).replace(b"vertex 12", f"vertex {claim}".encode())
    assert str(claim) in refused("a.ply", data).reason
    off = off_text(*prism()).replace("OFF12", f"OFF {claim}")
    assert refused("a.off", off).status == Status.UNREADABLE


@pytest.mark.parametrize("claim", [2**31, 4 * 10**9, 10**40, -1, 1.5, "12", None])
def test_a_gltf_accessor_that_lies_is_refused(box, claim):
    document, body = gltf_parts(box)
    document["accessors"][0]["count"] = claim
    refused("a.glb", glb(document, body))
    del document["accessors"][0]["bufferView"]
    refused("a.glb", glb(document, body))


def gltf_parts(mesh: TriangleMesh) -> tuple[dict, bytes]:
    data = write_glb(mesh)
    end = 20 + struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20:end]), data[end + 8 :]


def glb(document: dict, body: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def test_a_gltf_node_scales_then_turns_then_moves(box):
    document, body = gltf_parts(box)
    half = np.sqrt(0.5)
    document["nodes"] = [
        {"mesh": 0},
        {"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 2 * half, 2 * half]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 1, 1]},
    ]
    document["scenes"] = [{"nodes": [0, 1, 2]}]
    plain, moved, scaled = np.split(read("a.glb", glb(document, body)).mesh.vertices, 3)
    x, y, z = plain.T
    np.testing.assert_allclose(moved, np.stack([1 - y, 2 + x, 3 + z], axis=1), atol=1e-12)
    np.testing.assert_allclose(scaled, np.stack([-y, 2 * x, z], axis=1), atol=1e-12)


def test_quantised_and_sparse_positions_are_read(box):
    document, _ = gltf_parts(box)
    whole = np.round(box.vertices / 0.5 * 32767).astype("<i2")
    padded = np.zeros((len(whole), 4), "<i2")
    padded[:, :3] = whole
    moved = (whole[:1] * (2 / 3)).astype("<i2")
    index = np.array([0], "<u2")
    blobs = [padded.tobytes(), box.faces.astype("<u2").tobytes(), index.tobytes(), moved.tobytes()]
    offsets = np.cumsum([0, *map(len, blobs)])
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    document["bufferViews"] = [
        {"buffer": 0, "byteOffset": int(o), "byteLength": len(b)}
        for o, b in zip(offsets, blobs, strict=False)
    ]
    document["bufferViews"][0]["byteStride"] = 8
    position = {"bufferView": 0, "componentType": 5122, "type": "VEC3", "normalized": True}
    document["accessors"] = [
        {**position, "count": len(whole)},
        {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": box.faces.size},
    ]
    document["nodes"] = [{"mesh": 0, "scale": [0.5, 0.5, 0.5]}]
    plain = read("a.glb", glb(document, b"".join(blobs)))
    np.testing.assert_allclose(plain.mesh.vertices, box.vertices, atol=1e-4)
    document["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 2, "componentType": 5123},
        "values": {"bufferView": 3},
    }
    sparse = read("a.glb", glb(document, b"".join(blobs)))
    expected = box.vertices.copy()
    expected[0] *= 2 / 3
    np.testing.assert_allclose(sparse.mesh.vertices, expected, atol=1e-4)


def draco_glb(mesh: TriangleMesh) -> bytes:
    draco = pytest.importorskip("DracoPy", reason="needs the extra `draco`")
    packed = draco.encode(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    document, _ = gltf_parts(mesh)
    name = "KHR_draco_mesh_compression"
    document["extensionsRequired"] = [name]
    document["bufferViews"] = [{"buffer": 0, "byteLength": len(packed)}]
    for accessor in document["accessors"]:
        del accessor["bufferView"]
    use = {"bufferView": 0, "attributes": {"POSITION": 0}}
    document["meshes"][0]["primitives"][0]["extensions"] = {name: use}
    return glb(document, packed)


def test_draco_gives_the_triangles_back(ball):
    content = read("a.glb", draco_glb(ball))
    assert len(content.mesh.faces) == len(ball.faces)
    assert volume(content) == pytest.approx(mass_properties(ball).volume, rel=1e-3)


def test_damaged_draco_is_refused(ball):
    data = bytearray(draco_glb(ball))
    place = data.index(b"DRACO")
    data[place + 11 : place + 60] = b"\xff" * 49
    assert refused("a.glb", bytes(data)).status == Status.UNREADABLE


def test_without_its_package_draco_names_the_extra(box, monkeypatch):
    document, body = gltf_parts(box)
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    document["meshes"][0]["primitives"][0]["extensions"] = extension
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    failure = refused("a.glb", glb(document, body))
    assert failure.status == Status.UNSUPPORTED
    assert "pip install 'bidexdata[draco]'" in failure.reason


def model(mesh: TriangleMesh, unit: str = "", extra: str = "", build: str = "") -> str:
    """A 3MF model whose object 1 is the mesh."""
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    build = build or "<item objectid='1'/>"
    return (
        f"<model {unit} xmlns='core' xmlns:p='production'><resources><object id='1'><mesh>"
        f"<vertices>{points}</vertices><triangles>{faces}</triangles></mesh></object>{extra}"
        f"</resources><build>{build}</build></model>"
    )


def archive(**parts: str | bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as out:
        for name, data in parts.items():
            out.writestr(name.replace("__", "/"), data)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("unit", "metres"), [("", 1e-3), ("unit='inch'", 0.0254), ("unit='micron'", 1e-6)]
)
def test_3mf_has_a_unit_and_z_up(box, unit, metres):
    content = read("a.3mf", archive(**{"3D__3dmodel.model": model(box, unit)}))
    assert content.metres_per_unit == metres
    np.testing.assert_array_equal(content.R_world_file, np.eye(3))
    assert volume(content) == pytest.approx(0.09)


def test_a_3mf_entry_that_leads_out_of_the_archive_is_warned_of(box):
    plain = {"3D__3dmodel.model": model(box, "unit='meter'")}
    assert read("a.3mf", archive(**plain)).warnings == ()
    content = read("a.3mf", archive(**plain, **{"..__..__escaped.model": b"<model/>"}))
    assert content.warnings == (
        "its archive holds '../../escaped.model', which leads out of it: "
        "nothing was unpacked there",
    )


def test_3mf_components_are_placed_by_rows_also_from_other_parts(box):
    # Rows: x to y, y to -x, then a move; the component doubles before the item turns.
    extra = (
        "<object id='2'><components><component objectid='1' p:path='/3D/Other.model' "
        "transform='2 0 0 0 2 0 0 0 2 0 0 0'/></components></object>"
    )
    build = "<item objectid='2' transform='0 1 0 -1 0 0 0 0 1 10 20 30'/>"
    parts = {"3D__3dmodel.model": model(box, "", extra, build), "3D__other.model": model(box)}
    content = read("a.3mf", archive(**parts))
    size = np.ptp(content.mesh.vertices, axis=0)
    np.testing.assert_allclose(size, [1.0, 1.2, 0.6])
    np.testing.assert_allclose(content.mesh.vertices.mean(axis=0), [10, 20, 30])
    assert volume(content) == pytest.approx(8 * 0.09)


def doubled_objects(levels: int) -> str:
    twice = "<object id='{}'><components>{}</components></object>"
    return "".join(
        twice.format(k + 2, f"<component objectid='{k + 1}'/>" * 2) for k in range(levels)
    )


def test_a_3mf_that_places_one_mesh_2_to_the_40_times_is_refused_at_once(box):
    text = model(box, "", doubled_objects(40), "<item objectid='41'/>")
    failure = refused("a.3mf", archive(**{"3D__3dmodel.model": text}))
    assert failure.status == Status.TOO_COMPLEX
    assert "load.max_instances" in failure.reason


def test_a_3mf_object_that_contains_itself_is_refused(box):
    loop = "<object id='2'><components><component objectid='2'/></components></object>"
    text = model(box, "", loop, "<item objectid='2'/>")
    assert "itself" in refused("a.3mf", archive(**{"3D__3dmodel.model": text})).reason


def test_an_archive_that_unpacks_to_more_than_the_bound_is_refused(box):
    bound = LoadConfig(max_unpacked_bytes=10**6)
    text = model(box).replace("<resources>", "<resources>" + " " * 2 * 10**6)
    failure = refused("a.3mf", archive(**{"3D__3dmodel.model": text}), bound)
    assert failure.status == Status.TOO_COMPLEX
    assert "load.max_unpacked_bytes" in failure.reason


LAUGHS = '<!DOCTYPE l [<!ENTITY a "1 ">' + "".join(
    f'<!ENTITY {b} "' + f"&{a};" * 10 + '">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused_in_every_xml(box, encoding):
    entities = LAUGHS + ']><model unit="&i;"/>'
    failure = refused("a.3mf", archive(**{"3D__3dmodel.model": entities.encode(encoding)}))
    assert "entities" in failure.reason
    secret = '<!DOCTYPE l [<!ENTITY x SYSTEM "file:///etc/hostname">]><COLLADA>&x;</COLLADA>'
    assert "entities" in refused("a.dae", secret.encode(encoding)).reason


def collada(mesh: TriangleMesh, nodes: str, shown: str, asset: str = "") -> str:
    """A mesh as polygons with normals between the indices."""
    text = " ".join(f"{x:.17g}" for x in mesh.vertices.ravel())
    corners = " ".join(f"{k} 0" for k in mesh.faces.ravel())
    count, faces = len(mesh.vertices), len(mesh.faces)
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
<library_geometries><geometry id="g"><asset><unit meter="7"/></asset><mesh>
<source id="p"><float_array id="a" count="{3 * count}">{text}</float_array><technique_common>
<accessor source="#a" count="{count}" stride="3"/></technique_common></source>
<source id="n"><float_array id="na" count="3">0 0 1</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/><vcount>{"3 " * faces}</vcount>
<p>{corners}</p></polylist></mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="s">{shown}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


GEOMETRY = '<instance_geometry url="#g"/>'


def test_collada_transforms_apply_in_their_order_and_defaults_are_y_up_and_metres(box):
    node = (
        "<node><translate>1 0 0</translate><rotate>0 0 2 90</rotate><scale>2 1 1</scale>"
        f"{GEOMETRY}</node>"
    )
    content = read("a.dae", collada(box, "", node))
    np.testing.assert_allclose(np.ptp(content.mesh.vertices, axis=0), [0.5, 1.2, 0.3])
    np.testing.assert_allclose(content.mesh.vertices.mean(axis=0), [1, 0, 0], atol=1e-12)
    assert content.metres_per_unit == 1.0
    np.testing.assert_array_equal(content.R_world_file @ [0, 1, 0], [0, 0, 1])
    asset = '<unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis>'
    content = read("a.dae", collada(box, "", node, asset))
    assert content.metres_per_unit == 0.0254
    np.testing.assert_array_equal(content.R_world_file, np.eye(3))


@pytest.mark.parametrize("axis", ["0 0 0", "nan 0 0", "1e308 1e308 0"])
def test_a_collada_turn_about_no_axis_turns_nothing(box, axis):
    node = f"<node><rotate>{axis} 1e308</rotate>{GEOMETRY}</node>"
    np.testing.assert_allclose(read("a.dae", collada(box, "", node)).mesh.vertices, box.vertices)
    refused("a.dae", collada(box, "", node.replace("1e308<", "inf<")))


@pytest.mark.parametrize("transform", ["skew", "lookat"])
def test_a_collada_transform_that_is_not_applied_is_refused_where_it_counts(box, transform):
    made = f"<{transform}>1 2 3 0 0 0 0 0 1</{transform}>"
    node = f"<node>{made}{GEOMETRY}</node>"
    with pytest.raises(PrepareFailure, match=f"<{transform}>") as caught:
        read("a.dae", collada(box, "", node))
    assert caught.value.status == Status.UNSUPPORTED
    camera = f'<node>{made}<instance_camera url="#c"/></node><node>{GEOMETRY}</node>'
    np.testing.assert_allclose(read("a.dae", collada(box, "", camera)).mesh.vertices, box.vertices)


def test_a_collada_turn_may_be_any_number_of_times_around(box):
    node = "<node><rotate>0 0 2 {}</rotate>{}</node>"
    once, often = (
        read("a.dae", collada(box, "", node.format(degrees, GEOMETRY))).mesh.vertices
        for degrees in (-90, 270 + 360 * 10**6)
    )
    np.testing.assert_allclose(once, often, atol=1e-12)


def test_collada_nodes_are_placed_where_they_are_named(box):
    library = f'<node id="b"><translate>0 5 0</translate>{GEOMETRY}</node>'
    shown = '<node><scale>-1 2 1</scale><instance_node url="#b"/><instance_node url="#b"/></node>'
    content = read("a.dae", collada(box, library, shown))
    assert len(content.mesh.faces) == 24
    np.testing.assert_allclose(content.mesh.vertices.mean(axis=0), [0, 10, 0], atol=1e-12)
    assert volume(content) > 0  # mirrored, so wound anew


def test_a_collada_scene_of_2_to_the_40_nodes_is_refused_at_once(box):
    nodes = f'<node id="n0">{GEOMETRY}</node>'
    for k in range(40):
        nodes += f'<node id="n{k + 1}">' + f'<instance_node url="#n{k}"/>' * 2 + "</node>"
    failure = refused("a.dae", collada(box, nodes, '<instance_node url="#n40"/>'))
    assert failure.status == Status.TOO_COMPLEX


def test_a_collada_node_that_contains_itself_is_refused(box):
    nodes = (
        '<node id="a"><instance_node url="#b"/></node><node id="b"><instance_node url="#a"/></node>'
    )
    assert "itself" in refused("a.dae", collada(box, nodes, '<instance_node url="#a"/>')).reason


def test_a_deep_collada_scene_is_read(box):
    deep = "<node><translate>0 0 1</translate>" * 200 + GEOMETRY + "</node>" * 200
    content = read("a.dae", collada(box, "", deep))
    np.testing.assert_allclose(content.mesh.vertices.mean(axis=0), [0, 0, 200], atol=1e-9)


def test_a_collada_file_that_names_another_file_reads_nothing(box):
    text = collada(box, "", '<instance_geometry url="other.dae#g"/>')
    assert "only its own parts" in refused("a.dae", text).reason


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("data", [b"", b"\0" * 200, b" \n" * 50, b"PK\3\4", b"\xff" * 500])
def test_rubbish_of_every_suffix_is_refused(suffix, data):
    assert refused(f"a{suffix}", data).status in (Status.UNREADABLE, Status.NO_FACES)


def test_a_link_out_of_a_named_folder_is_a_row_and_not_read(tmp_path, box):
    secret = write_stl(tmp_path / "secret.stl", box)
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "a.stl").symlink_to(secret)
    write_obj(folder / "b.obj", box)
    (folder / "c.obj").symlink_to(folder / "b.obj")
    first, second = resolve_sources([str(folder)])  # the third is the second
    assert "outside" in first.problem
    assert not second.problem
    (named,) = resolve_sources([str(folder / "*.stl")])
    assert not named.problem


def test_a_pipe_called_a_mesh_is_refused_and_not_waited_for(tmp_path, box):
    from bidexdata.objects.identity import source_identity

    os.mkfifo(tmp_path / "a.stl")
    (item,) = resolve_sources([str(tmp_path)])
    with pytest.raises(PrepareFailure, match="not a regular file"):
        source_identity(item, 10**6)


def test_a_file_above_the_size_bound_is_not_read(tmp_path, box):
    from bidexdata.objects.identity import source_identity

    (item,) = resolve_sources([str(write_stl(tmp_path / "a.stl", box))])
    with pytest.raises(PrepareFailure, match=r"load\.max_bytes") as caught:
        source_identity(item, 100)
    assert caught.value.status == Status.TOO_COMPLEX
