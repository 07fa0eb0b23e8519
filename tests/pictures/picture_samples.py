"""Small real things that the tests of pictures and viewer draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bidexdata.frames import invert, pos_quat, quat_canonical
from bidexdata.hands import Hand
from bidexdata.objects.prepared import Solid, TriangleMesh
from bidexdata.record import GraspBatch, Header
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_written_by
from bidexdata.record.status import Status

BOX_FACES = np.array(
    [
        *([0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4]),
        *([2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]),
    ],
    np.int32,
)


def box_mesh(low, high) -> TriangleMesh:
    """Eight corners, twelve triangles, normals out."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    return TriangleMesh(low + corners * (high - low), BOX_FACES)


def box_solid(name: str, edges=(0.5, 0.4, 0.3)) -> Solid:
    """A box of unit diagonal, cut into two pieces."""
    e = np.array(edges) / np.linalg.norm(edges)
    half = e / 2
    left, right = -half, half
    return Solid(
        object_id=name,
        mesh=box_mesh(left, right),
        pieces=(
            box_mesh(left, [0, half[1], half[2]]),
            box_mesh([0, left[1], left[2]], right),
        ),
        volume=float(np.prod(e)),
        inertia=np.eye(3),
        rest_quats_wxyz=np.array([[1.0, 0, 0, 0]]),
        rest_heights=np.array([half[2]]),
        rest_probabilities=np.array([1.0]),
        provenance={"licence": "CC0-1.0", "piece_method": "convex", "warnings": ("a <warning>",)},
    )


def grasps(hands: tuple[Hand, ...], solid: Solid, n: int = 6) -> GraspBatch:
    """Hands at the two x faces of a box, palms towards it, closing over the stages.

    Sizes alternate 300 and 500 mm; every third grasp fails; all are selected, even ones audit. The
    last row is a failed attempt without a pose.
    """
    header = Header(hands=tuple(h.header() for h in hands))
    names = [*columns_written_by("synth"), "source_ref", *columns_written_by("validate")]
    c = empty_columns(header, names, n)
    numbers = np.arange(n)
    c["grasp_id"] = np.array([f"{i:015x}{solid.object_id[3]}" for i in numbers])
    c["object_id"] = np.array([solid.object_id] * n)
    c["size_mm"][:] = np.where(numbers % 2, 500, 300)
    c["size"][:] = c["size_mm"] / 1000
    c["scene_id"] = np.array([f"{solid.object_id}/{s}/float" for s in c["size_mm"]])
    c["setting"] = np.array(["floating"] * n)
    c["object_pos"][:] = 0
    c["object_quat_wxyz"][:] = [1, 0, 0, 0]
    sides = [("left", "right").index(hand.side) for hand in hands]
    c["sides"][:] = sides
    c["attempt"][:] = numbers
    for i in numbers[:-1]:
        half = solid.mesh.vertices.max(axis=0) * c["size_mm"][i] / 1000
        for h, hand in enumerate(hands):
            out = np.array([2 * sides[h] - 1.0, 0, 0])
            up = np.array([0, 0, 1.0])
            for stage, gap in enumerate((0.09, 0.05, 0.04)):
                T_world_palm = np.eye(4)
                T_world_palm[:3, :3] = np.stack([up, np.cross(-out, up), -out], axis=1)
                T_world_palm[:3, 3] = out * (half[0] + gap) - 0.05 * up
                p, q = pos_quat(T_world_palm @ invert(hand.T_hand_palm))
                c["hand_pos"][i, h, stage], c["hand_quat_wxyz"][i, h, stage] = p, q
                closed = hand.posture_open + stage / 2 * (hand.posture_curved - hand.posture_open)
                c["joints"][i, h, stage, : len(closed)] = closed
            for k in range(len(hand.contact_names)):
                c["contact_index"][i, h, k] = k
                c["contact_point"][i, h, k] = out * half[0] + up * 0.01 * k
                c["contact_normal"][i, h, k] = out
                c["contact_force"][i, h, k] = -0.5 * out
    c["hand_quat_wxyz"][:-1] = quat_canonical(c["hand_quat_wxyz"][:-1])
    c["selected"][:] = True
    c["audit"][:] = numbers % 2 == 0
    c["synth_status"][:] = Status.OK
    c["synth_status"][-1] = Status.NO_PLACEMENT
    c["verdict_status"][:] = np.where(numbers % 3 == 0, Status.SLIP, Status.OK)
    c["verdict_status"][-1] = Status.NOT_RUN
    c["success"][:] = c["verdict_status"] == Status.OK
    c["pd"][:] = 0.00123
    c["qp_residual"][:] = 0.25
    return GraspBatch(header, c)


class Made:
    """Two boxes with grasps, as if read from a run."""

    kind = "run"
    test = "f"
    tests: tuple[str, ...] = ("f",)
    protocol = "paper-1"

    def __init__(self, hands: tuple[Hand, ...], n: int = 6):
        self.path = Path("made")
        solids = [box_solid("box0-00000000"), box_solid("box1-00000001", (0.6, 0.2, 0.2))]
        self.solids = {s.object_id: s for s in solids}
        self._hands = hands
        self.batches = {s.object_id: grasps(hands, s, n) for s in solids}

    @property
    def object_ids(self):
        return tuple(self.solids)

    def categories(self):
        return ("crate", "beam")

    def index(self):
        return None

    def load_solid(self, object_id):
        return self.solids[object_id]

    def grasps(self, object_id, test=""):
        return self.batches[object_id]

    def hands(self):
        return self._hands

    @property
    def rig(self):
        return ""

    def arms(self, object_id):
        return None

    def robot(self):
        return None
