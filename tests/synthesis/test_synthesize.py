"""Laws of the whole synthesis: rows, counts, bytes, failures."""

import shutil

import numpy as np
import pytest
import yaml

from bidexdata.config import with_overrides
from bidexdata.hands import load_hands
from bidexdata.hands.contact_sets import set_numbers
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.registry import spec_path
from bidexdata.objects.distance_field import signed_distance
from bidexdata.record import Scene, Status
from bidexdata.record.fields import FIELDS, columns_written_by
from bidexdata.synthesis.attempts import grasp_ids, scene_seed
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.table import table_plane

GRASPS = 3
# Poses are stored as float32 of metres up to one.
F32 = 1e-6


@pytest.fixture(scope="module")
def scenes(obj):
    return [Scene(obj.object_id, 400), Scene(obj.object_id, 600)]


@pytest.fixture(scope="module")
def batch(obj, hands, scenes):
    return synthesize(obj, hands, scenes, seed=7, grasps=GRASPS, run_fingerprint="test")


def identical(a, b):
    return all(
        np.array_equal(a[k], b[k], equal_nan=a[k].dtype.kind == "f") for k in a.columns
    ) and set(a.columns) == set(b.columns)


def test_all_columns_of_the_stage_are_written(batch):
    assert set(batch.columns) == set(columns_written_by("synth"))


def test_sizes_are_those_of_the_scenes_in_metres(batch):
    assert batch.columns["size"].tolist() == (batch["size_mm"] / 1000).astype(np.float32).tolist()


def test_every_scene_has_its_audit_and_at_most_n_selected(batch, scenes):
    for scene in scenes:
        own = batch["scene_id"] == scene.scene_id
        assert np.sum(own & batch["audit"]) == GRASPS
        assert 0 < np.sum(own & batch["selected"]) <= GRASPS
    assert np.all(batch["audit"] | batch["selected"])
    assert np.all(batch["synth_status"][batch["selected"]] == Status.OK)


def test_the_header_counts_all_attempts(batch, scenes):
    for scene in scenes:
        assert sum(batch.header.counts[scene.scene_id].values()) == 4 * GRASPS
        own = batch["scene_id"] == scene.scene_id
        for status in np.unique(batch["synth_status"][own]):
            stored = np.sum(batch["synth_status"][own] == status)
            assert stored <= batch.header.counts[scene.scene_id][Status(status).label]


def test_good_rows_hold_numbers_and_failed_rows_none(batch):
    ok = batch["synth_status"] == Status.OK
    assert ok.any()
    touching = batch["contact_index"] >= 0
    assert np.all(touching[ok, :, :5])
    assert not touching[~ok].any()
    for name in ("contact_point", "contact_normal", "contact_force"):
        assert np.array_equal(np.isfinite(batch[name]).all(axis=-1), touching), name
        assert np.array_equal(np.isnan(batch[name]).all(axis=-1), ~touching), name
    for name in ("hand_pos", "hand_quat_wxyz", "joints", "qp_residual"):
        values = batch[name]
        assert np.isfinite(values[ok]).all(), name
        assert np.isnan(values[~ok]).all(), name
    quat = batch["hand_quat_wxyz"][ok]
    np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1, atol=F32)
    assert np.all(quat[..., 0] >= 0)


def test_contact_points_lie_on_the_surface_near_the_pads(batch, obj, hands):
    for row in np.flatnonzero(batch["synth_status"] == Status.OK):
        size = batch["size_mm"][row] / 1000
        for h, hand in enumerate(hands):
            numbers = batch["contact_index"][row, h]
            slot, number = np.flatnonzero(numbers >= 0), numbers[numbers >= 0]
            points = batch["contact_point"][row, h, slot].astype(float)
            distance, slope = signed_distance(obj.sdf, size, points)
            assert np.all(np.abs(distance) < 2e-3)
            assert np.all(np.sum(slope * batch["contact_normal"][row, h, slot], axis=1) > 0.5)
            pads = hand_points(
                hand,
                batch["joints"][row, h, 1].astype(float),
                batch["hand_pos"][row, h, 1].astype(float),
                batch["hand_quat_wxyz"][row, h, 1].astype(float),
            ).contact[number]
            away = np.linalg.norm(pads - points, axis=1) - hand.contact_radius[number]
            # A palm on a round body keeps some of its ten pads off it.
            assert np.median(np.abs(away)) < (5e-3 if len(number) == 5 else 10e-3)


def test_contact_forces_obey_their_cones_and_press(batch):
    ok = batch["synth_status"] == Status.OK
    f, n = np.nan_to_num(batch["contact_force"][ok]), -np.nan_to_num(batch["contact_normal"][ok])
    normal = np.sum(f * n, axis=-1)
    slide = np.linalg.norm(f - normal[..., None] * n, axis=-1)
    closure = SynthConfig().optimise.closure
    assert np.all(normal >= -1e-4)
    assert np.all(normal <= closure.qp.cap + 1e-4)
    assert np.all(slide <= closure.qp.mu * normal + 1e-4)
    assert np.all(normal.sum(axis=2) >= closure.qp.gamma - 1e-3)


def test_the_same_call_gives_the_same_bytes(batch, obj, hands, scenes):
    again = synthesize(obj, hands, scenes, seed=7, grasps=GRASPS, run_fingerprint="test")
    assert identical(batch, again)


def test_a_scene_does_not_know_the_others(batch, obj, hands, scenes):
    alone = synthesize(obj, hands, scenes[1:], seed=7, grasps=GRASPS, run_fingerprint="test")
    assert identical(batch.select(batch["scene_id"] == scenes[1].scene_id), alone)


def test_another_seed_gives_other_grasps(batch, obj, hands, scenes):
    other = synthesize(obj, hands, scenes[:1], seed=8, grasps=GRASPS)
    assert not np.any(np.isin(other["hand_pos"][:, 0, 0, 0], batch["hand_pos"][:, 0, 0, 0]))


def test_selected_grasps_are_the_best_balanced(batch, obj, hands, scenes):
    """Keeping fewer keeps a subset of those that were kept."""
    fewer = synthesize(
        obj, hands, scenes[:1], seed=7, grasps=1, candidates=4 * GRASPS, run_fingerprint="test"
    )
    best = set(fewer["grasp_id"][fewer["selected"]])
    assert best
    assert best <= set(batch["grasp_id"][batch["selected"]])


def test_an_object_without_region_pairs_ends_in_statuses(obj, hands, scenes):
    config = with_overrides(SynthConfig(), ["regions.gap=1.0", "regions.wide=10"])
    made = synthesize(obj, hands, scenes[:1], config, grasps=GRASPS)
    assert len(made) == GRASPS
    assert np.all(made["synth_status"] == Status.NO_REGION_PAIR)
    assert np.all(made["audit"])
    assert not made["selected"].any()
    assert np.isnan(made["hand_pos"]).all()
    assert made.header.counts[scenes[0].scene_id] == {"no_region_pair": 4 * GRASPS}


def test_attempts_are_numbered_on_when_a_run_grows(batch, obj, hands, scenes):
    more = synthesize(
        obj, hands, scenes[:1], seed=9, grasps=GRASPS, run_fingerprint="test", first_attempt=12
    )
    assert more["attempt"].min() >= 12
    assert not set(more["grasp_id"]) & set(batch["grasp_id"])


def test_ids_and_seeds_are_functions_of_their_names():
    ids = grasp_ids("run", "a/300/float", range(1000))
    assert len(set(ids)) == 1000
    assert all(len(i) == 16 and int(i, 16) >= 0 for i in ids)
    assert ids[:3] == grasp_ids("run", "a/300/float", [0, 1, 2])
    assert not set(ids) & set(grasp_ids("run", "a/500/float", range(1000)))
    seeds = {scene_seed(s, f"o/{k}/float") for s in range(30) for k in range(30)}
    assert len(seeds) == 900
    assert all(0 <= s < 2**63 for s in seeds)


def test_a_tabletop_scene_is_grasped_above_the_table(obj, hands):
    quat = obj.rest_quats_wxyz[0]
    scene = Scene(
        obj.object_id,
        500,
        "tabletop",
        0,
        (0.0, 0.0, float(obj.rest_heights[0]) * 0.5),
        tuple(float(x) for x in quat),
    )
    made = synthesize(obj, hands, [scene], seed=1, grasps=GRASPS)
    ok = np.flatnonzero(made["synth_status"] == Status.OK)
    assert len(ok)
    for row in ok:
        for h, hand in enumerate(hands):
            points = hand_points(
                hand,
                made["joints"][row, h, 1].astype(float),
                made["hand_pos"][row, h, 1].astype(float),
                made["hand_quat_wxyz"][row, h, 1].astype(float),
            )
            assert np.min(points.sphere[:, 2] - hand.sphere_radius) > -0.005


def test_the_table_seen_from_the_object_is_the_worlds_plane():
    turn = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # object y is up
    scene = Scene("o", 500, "tabletop", 0, (0.0, 0.0, 0.2), turn)
    plane = table_plane(scene)
    np.testing.assert_allclose(plane, [0, 1, 0, 0.2], atol=1e-12)
    assert not table_plane(Scene("o", 500)).any()


def test_columns_keep_their_dtypes(batch):
    for name, values in batch.columns.items():
        if FIELDS[name].dtype != "string":
            assert values.dtype == FIELDS[name].dtype


def test_the_paper_preset_runs(obj, hands, scenes):
    from bidexdata.synthesis.presets import load_preset

    config = load_preset("paper")
    made = synthesize(obj, hands, scenes[:1], config, seed=2, grasps=GRASPS)
    assert np.sum(made["audit"]) == GRASPS
    assert np.any(made["synth_status"] == Status.OK)


def test_hands_may_have_any_and_different_numbers_of_contacts(tmp_path, obj):
    spec = yaml.safe_load(spec_path("capsule").read_text())
    spec["contacts"] = [c for c in spec["contacts"] if c["name"] in ("ff", "rf", "th")]
    shutil.copy(spec_path("capsule").with_name("capsule_links.yaml"), tmp_path)
    (tmp_path / "three.yaml").write_text(yaml.safe_dump(spec))
    mixed = load_hands(f"{tmp_path / 'three.yaml'},capsule")
    batch = synthesize(obj, mixed, [Scene(obj.object_id, 300)], seed=1, grasps=2)
    made = batch.select(batch["synth_status"] == Status.OK)
    assert len(made) > 0
    numbers = made["contact_index"]
    assert np.all(numbers[:, 0, :3] == [0, 1, 2])
    assert np.all(numbers[:, 0, 3:] == -1)
    assert np.all(numbers[:, 1, :5] == [0, 1, 2, 3, 4])
    assert np.all(np.isnan(made["contact_force"]).all(axis=-1) == (numbers < 0))
    # Each hand presses with at least gamma, whatever the number of its contacts.
    along = -np.sum(made["contact_force"] * made["contact_normal"], axis=-1)
    assert np.all(np.nansum(along, axis=2) > 1 - 1e-3)


def test_attempts_take_contact_sets_in_turn_and_rows_say_which(obj, hands, scenes):
    config = with_overrides(SynthConfig(), ["placement.contacts=[fingertips, with_palm]"])
    made = synthesize(obj, hands, scenes, config, seed=7, grasps=GRASPS, run_fingerprint="test")
    good = made.select(made["synth_status"] == Status.OK)
    touching = np.sum(good["contact_index"] >= 0, axis=2)
    assert set(touching.ravel().tolist()) == {5, 10}
    assert np.all(touching == np.where(good["attempt"] % 2 == 0, 5, 10)[:, None])
    for h, hand in enumerate(hands):
        for name, rows in (
            ("fingertips", touching[:, h] == 5),
            ("with_palm", touching[:, h] == 10),
        ):
            numbers = set_numbers(hand, name)
            assert np.all(good["contact_index"][rows, h, : len(numbers)] == numbers)
    # Both kinds follow the same pairs: the first two attempts have the best.
    first = made.select(made["attempt"] < 2)
    for scene in scenes:
        ids = first["region_id"][first["scene_id"] == scene.scene_id]
        assert len(np.unique(ids, axis=0)) <= 1


def test_a_table_has_contact_sets_of_its_own(obj, hands):
    height = float(-obj.solid.vertices[:, 2].min() * 0.4)
    scene = Scene(obj.object_id, 400, "tabletop", 0, (0.0, 0.0, height))
    for name, count in (("fingertips", 5), ("with_palm", 10)):
        sets = ["placement.contacts=[pads]", f"placement.table_contacts=[{name}]"]
        config = with_overrides(SynthConfig(), sets)
        made = synthesize(obj, hands, [scene], config, seed=1, grasps=GRASPS)
        good = made.select(made["synth_status"] == Status.OK)
        assert len(good)
        assert np.all(np.sum(good["contact_index"] >= 0, axis=2) == count)


def test_with_palm_grasps_bring_the_palm_to_the_object(obj, hands):
    scene = [Scene(obj.object_id, 500)]
    found = {}
    for name in ("fingertips", "with_palm"):
        config = with_overrides(SynthConfig(), [f"placement.contacts=[{name}]"])
        made = synthesize(obj, hands, scene, config, seed=3, grasps=GRASPS)
        good = made.select(made["synth_status"] == Status.OK)
        palm = [
            hand_points(
                hands[1],
                good["joints"][row, 1, 1].astype(float),
                good["hand_pos"][row, 1, 1].astype(float),
                good["hand_quat_wxyz"][row, 1, 1].astype(float),
            ).contact[[part == "palm" for part in hands[1].contact_part]]
            for row in range(len(good))
        ]
        gaps = signed_distance(obj.sdf, 0.5, np.concatenate(palm))[0]
        found[name] = float(np.median(gaps))
    assert found["with_palm"] < 0.02
    assert found["fingertips"] > 0.03
