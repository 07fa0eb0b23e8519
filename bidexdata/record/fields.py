"""The field table: every column of the record, stated once.

Parquet and HDF5 metadata, the documentation's table, the card and the loader are generated from
`FIELDS`. Axes after the leading N (grasps): H sides, S stages (0 pregrasp, 1 grasp, 2 squeeze),
J joints, C contacts, A joints of an arm and the wrist it carries, K key frames of its motion, W
knots of its path; J, C and A are padded (NaN, or -1 for indices).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

STAGES = ("pregrasp", "grasp", "squeeze")
SIDES = ("left", "right")
DIRECTIONS = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Loads of test f, along the object's axes, in the order that the column `direction` counts."""

TESTS = ("f", "l", "a")
"""Tests that a grasp may have verdicts of: force closure, lift off a table, lift with arms. In the
order in which one stands for all where a single one is shown."""
JUDGED = ("f", "l", "a")
"""Those of them that can be run."""
ON_TABLE = ("l", "a")
"""Those of them whose scene has the table, so that rows must be of tabletop scenes."""
WITH_ARMS = ("a",)
"""Those of them that need arm solutions."""

KEY_FRAMES = ("home", "standoff", "pregrasp", "grasp", "squeeze", "lift")
"""Moments of the motion of two arms, the axis K."""
PHASES = ("approach", "reach", "close", "squeeze", "lift")
"""What the arms do between one key frame and the next."""

HEADLINE = ("pd", "spd", "cdc")
"""Metrics that stand for all where there is room for few."""
MEASURED = (*HEADLINE, "contact_number", "contact_distance")
"""Metrics that every validation measures: at the grasp, whatever the test."""
ANALYTIC = ("q1", "qp_certificate")
"""Metrics of the grasp that are computed when asked for."""
MOTION = ("drift_pos", "drift_rot", "time")
"""How the object moved in the test."""
OF_TEST = ("load_margin", *MOTION)
"""Metrics that depend on the test."""
METRICS = (*MEASURED, *ANALYTIC, *OF_TEST)
"""The columns written by `validate` that measure something. None is negative."""

Dtype = Literal["string", "bool", "int8", "int16", "int32", "int64", "float32"]
Table = Literal["grasps", "contacts", "verdicts", "arms", "objects", "scenes", "runs"]


@dataclass(frozen=True, slots=True)
class Field:
    """One column of the record."""

    name: str
    dtype: Dtype
    shape: str
    """Axes after N, for example "H S 3"; empty for one value per grasp."""
    unit: str
    frame: str
    written_by: str
    """The stage that writes the column."""
    table: Table
    """The release table that holds the column."""
    description: str

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes after N, as written in `shape`."""
        return tuple(self.shape.split())


def _f(
    name: str, dtype: Dtype, shape: str, unit: str, frame: str, by: str, table: Table, text: str
) -> Field:
    return Field(name, dtype, shape, unit, frame, by, table, text)


# fmt: off
_ALL = (
    # identity
    _f("grasp_id", "string", "", "", "", "synth", "grasps", "16 hex digits: hash of run fingerprint, scene_id and attempt"),
    _f("scene_id", "string", "", "", "", "synth", "grasps", "<object_id>/<size_mm>/float or .../table<k>"),
    _f("object_id", "string", "", "", "", "synth", "grasps", "slug of the source's id and first 8 hex digits of the source file's sha256"),
    _f("size_mm", "int32", "", "mm", "", "synth", "grasps", "bounding-box diagonal of the simulated solid in the object frame"),
    _f("size", "float32", "", "m", "object", "synth", "grasps", "bounding-box diagonal of the simulated solid; size_mm is this, rounded"),
    _f("setting", "string", "", "", "", "synth", "grasps", "floating or tabletop"),
    _f("object_pos", "float32", "3", "m", "world", "synth", "grasps", "origin of the object frame"),
    _f("object_quat_wxyz", "float32", "4", "", "world", "synth", "grasps", "orientation of the object frame, unit, w >= 0"),
    _f("sides", "int8", "H", "", "", "synth", "grasps", "side of each hand: 0 left, 1 right"),
    _f("attempt", "int32", "", "", "", "synth", "grasps", "number of the attempt within its scene; imported rows are numbered as they come"),
    _f("source_ref", "string", "", "", "", "import", "grasps", "file (and #row) an imported grasp came from; empty otherwise"),
    # pose
    _f("hand_pos", "float32", "H S 3", "m", "world", "synth", "grasps", "origin of the hand frame (root body) per stage"),
    _f("hand_quat_wxyz", "float32", "H S 4", "", "world", "synth", "grasps", "orientation of the hand frame per stage, unit, w >= 0"),
    _f("joints", "float32", "H S J", "rad", "", "synth", "grasps", "joint positions per stage, in the order of the header's joint_names"),
    # synthesis
    _f("region_id", "int16", "H", "", "", "synth", "grasps", "anchor number of the region each hand started at"),
    _f("region_score", "float32", "", "", "", "synth", "grasps", "score of the region pair, larger is better (meaning set by regions.score)"),
    _f("energy_qp", "float32", "", "", "", "synth", "grasps", "closure energy Q, summed over contact groups, unweighted (paper, appendix A)"),
    _f("energy_distance", "float32", "", "m2", "", "synth", "grasps", "E_dis at the grasp, unweighted (paper, appendix B)"),
    _f("energy_region", "float32", "", "m", "", "synth", "grasps", "E_region at the grasp, unweighted (paper, appendix B)"),
    _f("energy_penetration", "float32", "", "m2", "", "synth", "grasps", "squared hand-object sphere depths at the grasp, unweighted"),
    _f("energy_self", "float32", "", "m2", "", "synth", "grasps", "squared sphere overlaps within and between hands at the grasp, unweighted"),
    _f("energy_pad", "float32", "", "", "", "synth", "grasps", "squared hinge of the angle between pads and surface at the grasp, unweighted"),
    _f("qp_residual_hand", "float32", "H", "", "", "synth", "grasps", "zero-load QP residual of each hand alone"),
    _f("qp_residual", "float32", "", "", "", "synth", "grasps", "zero-load QP residual of all contacts together, each hand pressing"),
    _f("qp_residual_shifted", "float32", "", "", "", "synth", "grasps", "its mean over contacts that are moved along the surface; selection goes by it and the three that follow"),
    _f("settled_pressed", "float32", "", "m", "", "synth", "grasps", "when the hands have closed in the quasi-static model: how far the contact points of the hand that presses less would go on without the object, summed"),
    _f("settled_touching", "float32", "", "", "", "synth", "grasps", "contact points of both hands that press then, mean over four places of the object"),
    _f("settled_turned", "float32", "", "rad", "", "synth", "grasps", "how far the object has turned then, mean over the same"),
    _f("contact_index", "int16", "H C", "", "", "synth", "contacts", "number of the hand's contact point; -1 behind those that the grasp is made with"),
    _f("contact_point", "float32", "H C 3", "m", "object", "synth", "contacts", "object surface point closest to the contact point, at the grasp; the contact sphere need not touch it"),
    _f("contact_normal", "float32", "H C 3", "", "object", "synth", "contacts", "outward unit surface normal there"),
    _f("contact_force", "float32", "H C 3", "cap", "object", "synth", "contacts", "force on the object in the coupled zero-load QP, in units of the cap"),
    _f("force_scale", "float32", "H", "N", "", "synth", "contacts", "newtons per unit of contact_force: to G + extrapolate (G - G_pre) the squeeze adds the joint torques J^T f of these forces, and base_lead times what the base gives way under them; 0 where it adds neither"),
    _f("steps", "int32", "", "", "", "synth", "grasps", "optimiser steps taken"),
    _f("seed", "int64", "", "", "", "synth", "grasps", "seed of the task that made the attempt"),
    _f("selected", "bool", "", "", "", "synth", "grasps", "one of the N best attempts of its scene; imported: has a grasp"),
    _f("audit", "bool", "", "", "", "synth", "grasps", "one of the N attempts drawn before any filter; imported: our hand cannot take it (joint_range)"),
    _f("synth_status", "int8", "", "", "", "synth", "grasps", "Status of the attempt; poses are NaN where it has none"),
    # arms, one set per rig
    _f("arm_status", "int8", "", "", "", "arms", "arms", "Status of the arms' motion: OK or what stands against it"),
    _f("arm_joints", "float32", "H K A", "rad", "", "arms", "arms", "angles at each key frame (home, standoff, pregrasp, grasp, squeeze, lift): the arm's joints, then the wrist's, in the order of the header's arms; of a motion that failed, as far as it is known"),
    _f("arm_path", "float32", "H W A", "rad", "", "arms", "arms", "the same at every knot of the motion, key frames included; NaN where there is none"),
    _f("arm_time", "float32", "W", "s", "", "arms", "arms", "when both arms pass the knots, since home"),
    _f("ik_error_pos", "float32", "H K", "m", "world", "arms", "arms", "distance of the origin of the hand frame, at the stored angles, from where the key frame has it; at the palm frame it may differ by what ik_error_rot turns the way there, at most 0.5 mm for Shadow; NaN at home"),
    _f("ik_error_rot", "float32", "H K", "rad", "world", "arms", "arms", "angle between the same hand frames, which is that between palm frames"),
    _f("arm_step", "float32", "", "rad", "", "arms", "arms", "largest turn of a joint from knot to knot"),
    _f("clear_table", "float32", "", "m", "", "arms", "arms", "least signed distance to the table by MuJoCo over the motion, at its knots and between them where something is near: of arms always, of hands from home to the pre-grasp; larger ones than 0.01 m are that"),
    _f("clear_object", "float32", "", "m", "", "arms", "arms", "the same to the object: of arms always, of hands from home to the pre-grasp"),
    _f("clear_arms", "float32", "", "m", "", "arms", "arms", "the same between the two arms, and from each to the other's hand; between the hands from home to the pre-grasp"),
    _f("clear_self", "float32", "", "m", "", "arms", "arms", "the same within one arm with its hand, and to the rig's fixtures; without a hand's own forearm and wrist against it, which are as near in every posture"),
    _f("manipulability", "float32", "H", "", "", "arms", "arms", "root of det(J J^T) at the grasp, a turn of one radian counted as 0.3 m"),
    _f("arm_starts", "int16", "H", "", "", "arms", "arms", "starts of the inverse kinematics at the grasp"),
    _f("arm_failed_side", "int8", "", "", "", "arms", "arms", "side that failed: 0 left, 1 right; -1 none or both"),
    # verdicts, one set per protocol and test
    _f("success", "bool", "", "", "", "validate", "verdicts", "the grasp passed the test"),
    _f("verdict_status", "int8", "", "", "", "validate", "verdicts", "Status of the test: OK or the reason of the failure"),
    _f("failed_stage", "int8", "", "", "", "validate", "verdicts", "part of the test that failed: 0 start, 1 closing, 2 lift, 3 hold, 4 approach of the arms; -1 passed or not simulated"),
    _f("direction", "int8", "", "", "object", "validate", "verdicts", "first failing load direction of test f: 0..5 = +x -x +y -y +z -z; -1 none"),
    _f("drift_pos", "float32", "", "m", "world", "validate", "verdicts", "largest displacement of the object at a check or an early end"),
    _f("drift_rot", "float32", "", "rad", "world", "validate", "verdicts", "largest rotation of the object at a check or an early end"),
    _f("time", "float32", "", "s", "", "validate", "verdicts", "simulated time of the failure since the start of its phase; NaN on success"),
    _f("load_margin", "float32", "", "", "", "validate", "verdicts", "largest multiple of the protocol's load on the object that holds; NaN = not measured"),
    _f("pd", "float32", "", "m", "", "validate", "verdicts", "deepest penetration of one hand geom and one convex piece at the grasp, by pairs and not of their union: overlapping pieces may report other depths than the surface"),
    _f("spd", "float32", "", "m", "", "validate", "verdicts", "deepest penetration of two geoms of a hand or of two hands at the grasp, by pairs too"),
    _f("cdc", "float32", "", "m", "", "validate", "verdicts", "largest minus smallest signed finger-object distance at the grasp"),
    _f("q1", "float32", "", "", "", "validate", "verdicts", "Ferrari-Canny quality of the fingertip contacts, larger is better: 2 - DexGraspBench's q1_metric; fingertips whose normals cancel are left out; NaN = not computed"),
    _f("qp_certificate", "float32", "", "", "", "validate", "verdicts", "mean norm of the wrench residual, N and N m mixed, that OSQP certifies over six small forces, smaller is better (DexGraspBench's qp_metric); fingertips whose normals cancel are left out; NaN = not computed"),
    _f("contact_number", "int16", "", "", "", "validate", "verdicts", "palm, metacarpal and finger segments within the protocol's contact distance of the object"),
    _f("contact_distance", "float32", "", "m", "", "validate", "verdicts", "mean over fingers of the distance to the object"),
)
# fmt: on

FIELDS: dict[str, Field] = {field.name: field for field in _ALL}

ADDED_IN = {
    **dict.fromkeys(("size", "failed_stage", "q1", "qp_certificate"), "1.1"),
    **dict.fromkeys(("settled_pressed", "settled_touching", "settled_turned"), "1.2"),
    **{field.name: "1.3" for field in _ALL if field.table == "arms"},
}
"""Schema version that brought a column; data of earlier versions does without it."""


def columns_written_by(stage: str) -> tuple[str, ...]:
    """Names of the columns that a stage writes, in table order."""
    return tuple(f.name for f in _ALL if f.written_by == stage)


def columns_of_table(table: str) -> tuple[str, ...]:
    """Names of the columns that a release table holds, in table order."""
    return tuple(f.name for f in _ALL if f.table == table)
