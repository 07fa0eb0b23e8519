"""What is read, what is refused, and with which status."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from mesh_files import write_obj, write_stl

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.glb import read_glb, write_glb
from bidexdata.objects.loading import load_mesh, unit_mesh
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.weld import weld
from bidexdata.record.status import Status

CONFIG = LoadConfig()
DIAGONAL = np.sqrt(0.7)  # of the box 0.6 x 0.5 x 0.3
FLOAT32 = 1e-6


def load(path: Path, config=CONFIG):
    return load_mesh(path, path.read_bytes(), config)


def refused(path: Path) -> PrepareFailure:
    with pytest.raises(PrepareFailure) as caught:
        load(path)
    return caught.value


def made(folder: Path, name: str, data: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def assert_is_the_box(loaded, scale=1.0):
    assert loaded.diagonal == pytest.approx(scale * DIAGONAL, rel=FLOAT32)
    size = np.ptp(loaded.mesh.vertices, axis=0)
    np.testing.assert_allclose(size, np.array([0.6, 0.5, 0.3]) / DIAGONAL, atol=FLOAT32)
    closed = weld(loaded.mesh, 1e-6)
    assert mass_properties(closed).volume == pytest.approx(0.09 / DIAGONAL**3, rel=1e-5)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1000.0, 1e12])
def test_an_obj_of_any_size_keeps_its_shape(tmp_path, box, scale):
    path = write_obj(tmp_path / "box.obj", TriangleMesh(box.vertices * scale, box.faces))
    assert_is_the_box(load(path), scale)


def test_a_mesh_far_from_the_origin_keeps_its_shape(tmp_path, box):
    path = write_obj(tmp_path / "box.obj", TriangleMesh(box.vertices + 1e6, box.faces))
    loaded = load(path)
    assert_is_the_box(loaded)
    np.testing.assert_allclose(loaded.centre, 1e6)


def test_a_binary_stl_is_read_whatever_its_header_says(tmp_path, box):
    path = write_stl(tmp_path / "box.STL", box)
    assert_is_the_box(load(path))
    data = path.read_bytes()
    path.write_bytes(b"solid but binary".ljust(80) + data[80:])
    assert_is_the_box(load(path))


def test_gltf_is_turned_from_y_up_to_z_up(tmp_path, box):
    # Our writer turns z up to y up by a node; reading it as a source turns back.
    loaded = load(made(tmp_path, "box.glb", write_glb(box)))
    assert_is_the_box(loaded)
    assert loaded.metres_per_unit == 1.0
    document = gltf(box)
    document["nodes"] = [{"mesh": 0}]
    flat = load(made(tmp_path, "flat.glb", glb(document, box)))
    size = np.ptp(flat.mesh.vertices, axis=0) * DIAGONAL
    np.testing.assert_allclose(size, [0.6, 0.3, 0.5], atol=FLOAT32)


def test_nodes_with_scale_and_mirror_keep_faces_outward(tmp_path, box):
    document = gltf(box)
    document["nodes"] = [{"mesh": 0, "scale": [-1, 2, 1]}]
    loaded = load(made(tmp_path, "mirrored.glb", glb(document, box)))
    unit = weld(loaded.mesh, 1e-6)
    assert mass_properties(unit).volume * loaded.diagonal**3 == pytest.approx(0.18, rel=1e-5)


@pytest.mark.parametrize(
    ("axis", "size"),
    [("X_UP", [0.5, 0.3, 0.6]), ("Y_UP", [0.6, 0.3, 0.5]), ("Z_UP", [0.6, 0.5, 0.3])],
)
def test_collada_axes_are_turned_to_z_up(tmp_path, box, axis, size):
    loaded = load(made(tmp_path, "box.dae", collada(box, axis)))
    np.testing.assert_allclose(
        np.ptp(loaded.mesh.vertices, axis=0) * loaded.diagonal, size, atol=1e-5
    )
    assert loaded.metres_per_unit == 0.01
    closed = weld(loaded.mesh, 1e-6)
    assert mass_properties(closed).volume > 0


def test_vertices_without_faces_do_not_count(tmp_path, box):
    stray = np.concatenate([box.vertices, [[100.0, 0, 0], [np.nan, 0, 0]]])
    assert_is_the_box(unit_mesh(TriangleMesh(stray, box.faces), CONFIG))


def test_missing_materials_are_no_error(tmp_path, box):
    path = write_obj(tmp_path / "box.obj", box)
    path.write_text("mtllib ../../nowhere.mtl\nusemtl none\n" + path.read_text())
    assert_is_the_box(load(path))


def test_what_no_honest_file_has_is_read_with_a_warning(tmp_path, box):
    path = write_obj(tmp_path / "box.obj", box)
    text = path.read_bytes()
    assert load(path).warnings == ()
    path.write_bytes(b"mtllib own.mtl\nmtllib ../../secret.mtl\n" + text.replace(b"\n", b"\0\n", 3))
    loaded = load(path)
    assert_is_the_box(loaded)
    assert loaded.warnings == (
        "3 NUL bytes in the text: is the file damaged?",
        "it names '../../secret.mtl', which is not read",
    )
    packed = bytearray(write_glb(box))
    assert load(made(tmp_path, "box.glb", bytes(packed))).warnings == ()
    packed[8:12] = struct.pack("<I", 4_000_000_000)
    (warning,) = load(made(tmp_path, "lie.glb", bytes(packed))).warnings
    assert warning == f"its header claims 4000000000 bytes, the file has {len(packed)}"


@pytest.mark.parametrize(("far", "warned"), [(0.0, False), (100.0, False), (1e5, True)])
def test_single_precision_far_from_the_origin_is_warned_of(tmp_path, box, far, warned):
    moved = TriangleMesh(box.vertices + far, box.faces)
    single = load(write_stl(tmp_path / "box.stl", moved))
    assert bool(single.warnings) == warned
    assert load(write_obj(tmp_path / "box.obj", moved)).warnings == ()  # double precision
    if warned:
        # Neighbouring numbers at 1e5 are 2^-7 apart.
        assert f"coordinates are {2**-7 / single.diagonal:.2%} of" in single.warnings[0]


CASES = {
    "empty.stl": (b"", Status.UNREADABLE),
    "empty.glb": (b"", Status.UNREADABLE),
    "letter.obj": ("Dear reader,\nthis is a letter.\n", Status.NO_FACES),
    "points.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", Status.NO_FACES),
    "zero.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", Status.UNREADABLE),
    "zero_slash.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1/1 2/2/2 0/1/1\n", Status.UNREADABLE),
    "beyond.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", Status.UNREADABLE),
    "point.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", Status.NOT_FINITE_MESH),
    "words.ply": ("ply\nformat ascii 1.0\nelement vertex many\n", Status.UNREADABLE),
    "mesh.blend": (b"BLENDER", Status.UNSUPPORTED),
    "not.glb": (b"glTX" + bytes(40), Status.UNREADABLE),
    "json.gltf": ("[1, 2]", Status.UNREADABLE),
    "deep.gltf": ("[" * 20000 + "]" * 20000, Status.UNREADABLE),
    "broken.dae": ("<COLLADA><unclosed></COLLADA>", Status.UNREADABLE),
    "entity.dae": (
        '<!DOCTYPE l [<!ENTITY x SYSTEM "file:///etc/hostname">]><COLLADA>&x;</COLLADA>',
        Status.UNREADABLE,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_bad_file_is_refused_with_its_status(tmp_path, name):
    data, status = CASES[name]
    failure = refused(made(tmp_path, name, data))
    assert failure.status == status, failure
    assert failure.reason


@pytest.mark.parametrize("count", [0, 11, 13, 2**32 - 1])
def test_an_stl_whose_header_lies_is_refused_with_both_counts(tmp_path, box, count):
    path = write_stl(tmp_path / "box.stl", box)
    data = bytearray(path.read_bytes())
    data[80:84] = struct.pack("<I", count)
    path.write_bytes(data)
    assert refused(path).status == Status.UNREADABLE
    assert str(count) in refused(path).reason
    assert "12" in refused(path).reason


def test_a_cut_off_stl_is_refused(tmp_path, box):
    path = write_stl(tmp_path / "box.stl", box)
    path.write_bytes(path.read_bytes()[:-60])
    assert refused(path).status == Status.UNREADABLE


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_many_vertices_that_are_no_numbers_are_refused(tmp_path, box, value):
    vertices = box.vertices.copy()
    vertices[3, 1] = value
    path = write_stl(tmp_path / "box.stl", TriangleMesh(vertices, box.faces))
    assert refused(path).status == Status.NOT_FINITE_MESH


def test_few_vertices_that_are_no_numbers_cost_their_faces_and_a_warning(tmp_path, ball):
    vertices = ball.vertices.copy()
    vertices[[7, 70]] = np.nan
    lost = int(np.isin(ball.faces, [7, 70]).any(axis=1).sum())
    loaded = load(write_obj(tmp_path / "ball.obj", TriangleMesh(vertices, ball.faces)))
    assert len(loaded.mesh.faces) == len(ball.faces) - lost
    (warning,) = loaded.warnings
    assert warning == f"2 vertices are not finite: {lost} of {len(ball.faces)} faces dropped"


def test_a_file_that_needs_an_unknown_extension_is_unsupported(tmp_path, box):
    document = gltf(box)
    document["extensionsRequired"] = ["EXT_meshopt_compression"]
    failure = refused(made(tmp_path, "packed.glb", glb(document, box)))
    assert failure.status == Status.UNSUPPORTED
    assert "EXT_meshopt_compression" in failure.reason


@pytest.mark.parametrize(
    ("nodes", "status"),
    [
        ([{"children": [1]}, {"children": [0, 2]}, {"mesh": 0}], Status.UNREADABLE),
        ([{"children": [1, 1]}, {"mesh": 0}], Status.UNREADABLE),
        ([{"children": [7]}, {"mesh": 0}], Status.UNREADABLE),
        ([{"children": [0]}, {"mesh": 0}], Status.UNREADABLE),
    ],
    ids=["cycle", "two parents", "no such node", "its own child"],
)
def test_illegal_or_endless_node_trees_are_refused(tmp_path, box, nodes, status):
    document = gltf(box)
    document["nodes"] = nodes
    assert refused(made(tmp_path, "nodes.glb", glb(document, box))).status == status


def test_a_chain_of_4000_nodes_moves_the_mesh_4000_times(tmp_path, box):
    document = gltf(box)
    chain = [{"children": [k + 1], "translation": [0.001, 0, 0]} for k in range(4000)]
    document["nodes"] = [*chain, {"mesh": 0}]
    loaded = load(made(tmp_path, "chain.glb", glb(document, box)))
    np.testing.assert_allclose(loaded.centre, [4, 0, 0], atol=1e-9)
    assert loaded.diagonal == pytest.approx(DIAGONAL, rel=FLOAT32)


def test_more_nodes_than_the_bound_are_refused_before_they_are_placed(tmp_path, box):
    document = gltf(box)
    document["nodes"] = [{"mesh": 0}] * 6
    document["scenes"] = [{"nodes": list(range(6))}]
    path = made(tmp_path, "many.glb", glb(document, box))
    assert len(load(path).mesh.faces) == 6 * 12
    for bound in (LoadConfig(max_instances=5), LoadConfig(max_faces=71)):
        with pytest.raises(PrepareFailure) as caught:
            load(path, bound)
        assert caught.value.status == Status.TOO_COMPLEX


def test_a_reference_out_of_the_folder_reads_nothing(tmp_path, box):
    document = gltf(box)
    secret = tmp_path / "secret.bin"
    secret.write_bytes(blob(box))
    folder = tmp_path / "inner"
    folder.mkdir()
    document["buffers"][0]["uri"] = "../secret.bin"
    assert refused(made(folder, "a.gltf", json.dumps(document))).status == Status.UNREADABLE
    document["buffers"][0]["uri"] = secret.as_uri()
    assert refused(made(folder, "b.gltf", json.dumps(document))).status == Status.UNREADABLE
    (folder / "link.bin").symlink_to(secret)
    document["buffers"][0]["uri"] = "link.bin"
    assert "outside its folder" in refused(made(folder, "c.gltf", json.dumps(document))).reason
    (folder / "link.bin").unlink()
    (folder / "link.bin").write_bytes(blob(box))
    assert_is_the_box(load(made(folder, "d.gltf", json.dumps(document))))


def test_more_faces_than_the_bound_are_refused(tmp_path, box):
    path = write_stl(tmp_path / "box.stl", box)
    with pytest.raises(PrepareFailure) as caught:
        load(path, LoadConfig(max_faces=11))
    assert caught.value.status == Status.TOO_COMPLEX


def test_glb_round_trip_is_exact_and_deterministic(box):
    single = TriangleMesh(box.vertices.astype(np.float32).astype(float), box.faces)
    data = write_glb(single)
    back = read_glb(data, "box.glb")
    assert np.array_equal(back.vertices, single.vertices)
    assert np.array_equal(back.faces, single.faces)
    assert write_glb(back) == data


def blob(mesh: TriangleMesh) -> bytes:
    return mesh.vertices.astype("<f4").tobytes() + mesh.faces.astype("<u4").tobytes()


def gltf(mesh: TriangleMesh) -> dict:
    """The JSON part of our own writer's file, to be spoilt."""
    data = write_glb(mesh)
    return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])


def glb(document: dict, mesh: TriangleMesh) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(blob(mesh)), b"BIN\0") + blob(mesh)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def collada(mesh: TriangleMesh, axis: str) -> str:
    numbers = " ".join(f"{x:.9g}" for x in mesh.vertices.ravel())
    indices = " ".join(map(str, mesh.faces.ravel()))
    count = len(mesh.vertices)
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="cm" meter="0.01"/><up_axis>{axis}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{3 * count}">{numbers}</float_array><technique_common>
<accessor source="#a" count="{count}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{len(mesh.faces)}"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{indices}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
