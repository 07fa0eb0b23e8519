"""The scenes table says where the object stands and what it weighs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_release import OBJECTS, SIZES, made_object, made_release, made_rows

from bidexdata.config import to_plain
from bidexdata.formats.release import Release
from bidexdata.formats.scene_facts import ScenePhysics
from bidexdata.simulation.settings import SceneSettings
from bidexdata.validation.protocols import load_protocol

OBJECT = OBJECTS[0]


@pytest.mark.parametrize("protocol", ["paper-1", "paper-1-mass500g"])
def test_mass_and_friction_are_those_of_the_simulation(tmp_path, protocol):
    def heavier(object_id):  # as an import states it: the mass belongs to another volume
        obj = made_object(object_id)
        return replace(obj, provenance={**obj.provenance, "nominal_volume": 2 * obj.volume})

    settings = load_protocol(protocol)
    out = made_release(
        tmp_path / "r",
        load_object=heavier,
        default_protocol=protocol,
        protocols={protocol: to_plain(settings)},
        tests=[(protocol, "f")],
        rows_of=lambda o: [replace(made_rows(o), verdicts={})],
    )
    rows = Release.open(out).scenes.to_pylist()
    assert {row["size_mm"] for row in rows} == set(SIZES)
    for row in rows:
        solid, size = heavier(row["object_id"]), row["size_mm"] / 1000
        scene: SceneSettings = settings.scene
        expected = solid.mass(size, scene.density_of(solid, size))
        assert row["mass"] == pytest.approx(expected, rel=1e-6)
        assert row["friction"] == pytest.approx(scene.friction_slide)
        if protocol == "paper-1-mass500g":
            assert row["mass"] == pytest.approx(0.25)


def test_without_a_protocol_they_are_not_known(packed):
    scenes = Release.open(packed).scenes
    assert np.isnan(scenes.column("mass").to_numpy()).all()
    assert np.isnan(scenes.column("friction").to_numpy()).all()


def test_a_floating_scene_has_the_identity_pose(packed):
    for row in Release.open(packed).scenes.to_pylist():
        assert row["object_pos"] == [0, 0, 0]
        assert row["object_quat_wxyz"] == [1, 0, 0, 0]
        assert not row["table"]


def test_a_scene_on_a_table_has_the_pose_of_its_rows(tmp_path):
    def still(object_id):
        made = made_rows(object_id, setting="tabletop")
        columns = dict(made.batch.columns)
        for name in ("object_pos", "object_quat_wxyz"):
            columns[name] = np.tile(columns[name][:1], (len(made.batch), 1))
        return [replace(made, batch=replace(made.batch, columns=columns))]

    for n, (rows_of, known) in enumerate(
        [(still, True), (lambda o: [made_rows(o, setting="tabletop")], False)]
    ):
        release = Release.open(made_release(tmp_path / str(n), (OBJECT,), rows_of=rows_of))
        for row in release.scenes.to_pylist():
            assert row["table"]
            assert np.isfinite(row["object_pos"]).all() == known  # rows that differ have none
            if known:
                batch = release.grasps(OBJECT, size_mm=row["size_mm"])
                assert row["object_pos"] == batch["object_pos"][0].tolist()
                assert row["object_quat_wxyz"] == batch["object_quat_wxyz"][0].tolist()


def test_objects_say_where_they_come_from_and_how_they_were_made(tmp_path):
    def addressed(object_id):
        obj = made_object(object_id)
        more = {"uri": "doi:10.1/x", "piece_method": "coacd", "repair_steps": ["weld"]}
        return replace(obj, provenance={**obj.provenance, **more})

    out = made_release(tmp_path / "r", (OBJECT,), load_object=addressed)
    (row,) = Release.open(out).objects.to_pylist()
    assert row["uri"] == "doi:10.1/x"
    assert row["recipe"] == '{"piece_method":"coacd","repair_steps":["weld"]}'
    assert row["nominal_volume"] == row["volume"]


def test_a_mass_that_is_fixed_belongs_to_the_nominal_volume():
    row = {"volume": 0.02, "nominal_volume": 0.04}
    free = ScenePhysics.of(row, {"scene": {"density": 2.5, "mass": None, "friction_slide": 0.6}})
    assert free.mass(0.5) == pytest.approx(2.5 * 0.02 * 0.125)
    fixed = ScenePhysics.of(row, {"scene": {"density": 2.5, "mass": 0.1, "friction_slide": 0.6}})
    assert fixed.mass(0.5) == fixed.mass(0.3) == pytest.approx(0.05)
    assert np.isnan(ScenePhysics.of(row, None).mass(0.5))
