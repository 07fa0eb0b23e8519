"""What an item holds, for type checkers: the columns of the field table and what loaders add.

Shapes are those of one grasp; a batch has a leading axis B, a case (`BiDexCases`) a leading axis G.
Axes: H hands, S stages, J joints, C contacts, P points, A joints of an arm and its wrist, K key frames,
W knots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from torch import Tensor


class GraspItem(TypedDict):
    """One grasp. An item has those of these keys that the options of `BiDexDataset` ask for."""

    # Always.
    object_index: Tensor
    """Number in `object_ids`, int64."""

    # Options.
    cloud_solid: Tensor
    """Points on the simulated solid [m], (P, 3)."""
    cloud_mesh: Tensor
    """Points on the repaired mesh [m], (P, 3)."""
    cloud_normal: Tensor
    """With `normals=True`: outward unit normals at the points of `cloud_solid`, (P, 3)."""
    point_index: Tensor
    """Batches with `clouds="unique"`: the cloud of each grasp, int64."""
    mirrored: Tensor
    """With `augment=("mirror",)`: whether the scene is its mirror image, bool."""
    hand_quat_xyzw: Tensor
    """With `quat_order="xyzw"`, (H, S, 4)."""
    hand_rot6d: Tensor
    """With `rotation="6d"`: first column of the matrix, then the second, (H, S, 6)."""
    hand_matrix: Tensor
    """With `rotation="matrix"`, (H, S, 3, 3)."""
    object_quat_xyzw: Tensor
    """(4)."""
    object_rot6d: Tensor
    """(6)."""
    object_matrix: Tensor
    """(3, 3)."""

    # Columns of the grasps table.
    grasp_id: str
    scene_id: str
    object_id: str
    size_mm: Tensor
    size: Tensor
    setting: str
    object_pos: Tensor
    object_quat_wxyz: Tensor
    sides: Tensor
    attempt: Tensor
    source_ref: str
    hand_pos: Tensor
    """(H, S, 3) [m]."""
    hand_quat_wxyz: Tensor
    """(H, S, 4)."""
    joints: Tensor
    """(H, S, J) [rad]; NaN behind a hand's last joint."""
    region_id: Tensor
    region_score: Tensor
    energy_qp: Tensor
    energy_distance: Tensor
    energy_region: Tensor
    energy_penetration: Tensor
    energy_self: Tensor
    energy_pad: Tensor
    qp_residual_hand: Tensor
    qp_residual: Tensor
    qp_residual_shifted: Tensor
    settled_pressed: Tensor
    settled_touching: Tensor
    settled_turned: Tensor
    steps: Tensor
    seed: Tensor
    selected: Tensor
    audit: Tensor
    synth_status: Tensor
    run: str
    suc_f: Tensor
    suc_l: Tensor
    suc_a: Tensor
    pd: Tensor
    spd: Tensor
    cdc: Tensor
    contact_number: Tensor
    contact_distance: Tensor

    # Columns of the contacts table.
    contact_index: Tensor
    """(H, C); -1 behind the last contact of a hand."""
    contact_point: Tensor
    """(H, C, 3) [m], object frame."""
    contact_normal: Tensor
    contact_force: Tensor
    force_scale: Tensor

    # Columns of the table of arms, of a release that has a rig.
    arm_status: Tensor
    arm_joints: Tensor
    """(H, K, A) [rad]; NaN behind an arm's last joint, and where there is no motion."""
    arm_path: Tensor
    """(H, W, A) [rad], likewise."""
    arm_time: Tensor
    """(W) [s]."""
    ik_error_pos: Tensor
    ik_error_rot: Tensor
    arm_step: Tensor
    clear_table: Tensor
    clear_object: Tensor
    clear_arms: Tensor
    clear_self: Tensor
    manipulability: Tensor
    arm_starts: Tensor
    arm_failed_side: Tensor
