"""Explain one attempt: make its scene again, and keep what became of the attempt at every stage.

Nothing is drawn or decided here that `synthesize` does not do: the same stages run in the same
order on the same numbers, so the rows that come out are the same too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.hands.contact_sets import contact_view
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.distance_field import signed_distance
from bidexdata.record import GraspBatch, Scene, Status
from bidexdata.synthesis.attempts import Attempts, draw_attempts
from bidexdata.synthesis.methods import search_bilevel
from bidexdata.synthesis.pipeline import grasp_attempts, outcome
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.results import Outcome, Staged
from bidexdata.synthesis.rows import scene_rows
from bidexdata.synthesis.selection import failures, selection_order
from bidexdata.synthesis.trace import Recorder, Trace

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.config import SynthConfig
    from bidexdata.synthesis.selection import SelectionConfig


class StagePose(NamedTuple):
    """Both hands of one attempt at one stage, object frame."""

    name: str
    """`start`, `quarter` (of the approach), `approach`, `pregrasp`, `grasp` or `squeeze`."""
    position: Float[np.ndarray, "2 3"]
    """Origins of the hand frames [m]."""
    quat_wxyz: Float[np.ndarray, "2 4"]
    joints: tuple[Float[np.ndarray, " J0"], Float[np.ndarray, " J1"]]
    """[rad]."""
    gaps: tuple[Float[np.ndarray, " C0"], Float[np.ndarray, " C1"]]
    """Signed distance of each hand's pads from the surface [m]."""
    depth: float
    """Deepest collision sphere of both hands in the object [m]; 0 where none is in it."""


class Finished(NamedTuple):
    """Contacts and criteria of one attempt that was optimised; C contacts of each hand."""

    points: tuple[Float[np.ndarray, "C0 3"], Float[np.ndarray, "C1 3"]]
    """Surface points under the pads at the grasp, object frame [m]."""
    normals_in: tuple[Float[np.ndarray, "C0 3"], Float[np.ndarray, "C1 3"]]
    """Inward unit normals there."""
    forces: tuple[Float[np.ndarray, "C0 3"], Float[np.ndarray, "C1 3"]]
    """Forces on the object of the coupled zero-load QP [caps]."""
    force_scale: Float[np.ndarray, " 2"]
    """Newtons per cap of each hand; 0 where the squeeze adds none."""
    residual_hand: Float[np.ndarray, " 2"]
    """Zero-load QP residual of each hand alone [-]."""
    gaps: tuple[Float[np.ndarray, " C0"], Float[np.ndarray, " C1"]]
    """Signed distances of the pads at the grasp, as the contacts are counted by [m]."""
    among_hands: float
    """Deepest overlap within and between the hands at the pre-grasp [m]."""
    table: float
    """Deepest overlap of hands and table at any stage [m]."""
    reasons: tuple[Status, ...]
    """Every reason by which the attempt fails; the first is its status."""
    arms: Status | None
    """What the arms of the rig come to; None without a rig, or where the attempt failed before."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Explanation:
    """One attempt of a scene beside all the others of its round."""

    number: int
    """Place of the attempt among those of its round."""
    attempts: Attempts
    """All M of the scene, with the region pairs and placements they have."""
    found: Outcome
    """What became of all M."""
    hands: tuple[Hand, Hand]
    """With the contact points that the attempt touches with."""
    order: Int[np.ndarray, " U"]
    """Attempts that may be kept, best first."""
    poses: tuple[StagePose, ...]
    """The hands from the start on, as far as the attempt came; where no start is free the last that
    was drawn."""
    trace: Trace | None
    """None without a start."""
    finished: Finished | None
    """None without a start."""
    rows: GraspBatch
    """The rows of the scene, as `synthesize` makes them."""

    @property
    def status(self) -> Status:
        """What became of the attempt."""
        return Status(int(self.found.status[self.number]))

    @property
    def rank(self) -> int | None:
        """Place in the selection's order, from 1; None where the attempt may not be kept."""
        place = np.flatnonzero(self.order == self.number)
        return int(place[0]) + 1 if len(place) else None


def explain_attempt(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    scene: Scene,
    config: SynthConfig,
    seed: int,
    number: int,
    *,
    grasps: int,
    candidates: int,
    run_fingerprint: str = "",
    first_attempt: int = 0,
    device: str = "cpu",
    reach: Reach | None = None,
) -> Explanation:
    """Make a scene's grasps again and keep one attempt's way.

    Args:
        obj: The object.
        hands: Left and right.
        scene: Of this object.
        config: All constants.
        seed: Of the round.
        number: Place of the attempt among those of the round, from 0.
        grasps: As for `synthesize`, likewise all that follows.
        candidates: M.
        run_fingerprint: Names the run in the grasps' ids.
        first_attempt: Number of the round's first attempt.
        device: Warp device.
        reach: Arms that the grasps are made for.
    """
    grown = first_attempt > 0
    one = draw_attempts(
        *(obj, hands, scene, config, seed, candidates), grown=grown, device=device, reach=reach
    )
    placed, touching = one.status == Status.OK, one.contact_set[number]
    views = (contact_view(hands[0], touching), contact_view(hands[1], touching))
    row = int(np.count_nonzero(placed[:number])) if placed[number] else None
    recorder = None
    if row is not None:
        recorder = Recorder(one.start_sets[:row].count(touching), views, config.optimise)
    search = partial(search_bilevel, watch=recorder)
    staged = grasp_attempts(
        obj, hands, [one], config, device, searches={touching: search}, reach=reach
    )
    starts = np.arange(np.count_nonzero(placed))
    found = outcome(one, staged, starts, grasps, config.selection)
    trace = None if recorder is None else recorder.trace()
    poses = _placement(one, views, number)
    if row is not None and trace is not None:
        mine = slice(row, row + 1)
        ends = {
            "pregrasp": staged.made.pregrasp.rows(mine),
            "squeeze": staged.made.squeeze.rows(mine),
        }
        poses = {**trace.poses, **ends}
    return Explanation(
        number=number,
        attempts=one,
        found=found,
        order=selection_order(
            *(found.status, found.depth, found.residual, found.doubt),
            *(found.places, config.selection),
        ),
        hands=views,
        poses=tuple(_stage_pose(n, p, obj, views, scene.size) for n, p in poses.items()),
        trace=trace,
        finished=None if row is None else _finished(staged, row, views, config.selection),
        rows=scene_rows(
            *(hands, one, staged, starts, found, config),
            first_attempt=first_attempt,
            run_fingerprint=run_fingerprint,
        ),
    )


def _placement(one: Attempts, hands: Sequence[Hand], number: int) -> Mapping[str, Pose]:
    """The last start that was drawn for an attempt."""
    if one.placed is None:
        return {}
    placed, row = one.placed, slice(number, number + 1)
    joints = [placed.joints[row, h, : len(hand.joint_names)] for h, hand in enumerate(hands)]
    return {"start": Pose(placed.hand_pos[row], placed.hand_quat[row], (joints[0], joints[1]))}


def _stage_pose(
    name: str, pose: Pose, obj: PreparedObject, hands: Sequence[Hand], size: float
) -> StagePose:
    gaps, deepest = [], 0.0
    for h, hand in enumerate(hands):
        at = hand_points(hand, pose.joints[h][0], pose.position[0, h], pose.quat_wxyz[0, h])
        finite = np.isfinite(at.contact).all() and np.isfinite(at.sphere).all()
        if not finite:
            gaps.append(np.full(len(hand.contact_radius), np.nan))
            deepest = np.nan
            continue
        gaps.append(signed_distance(obj.sdf, size, at.contact)[0] - hand.contact_radius)
        inside = hand.sphere_radius - signed_distance(obj.sdf, size, at.sphere)[0]
        deepest = max(deepest, float(inside.max()))
    joints = (pose.joints[0][0], pose.joints[1][0])
    return StagePose(
        name, pose.position[0], pose.quat_wxyz[0], joints, (gaps[0], gaps[1]), float(deepest)
    )


def _finished(staged: Staged, row: int, hands: Sequence[Hand], config: SelectionConfig) -> Finished:
    contacts, deep = staged.made.contacts, staged.overlaps
    one = slice(row, row + 1)
    poses = (staged.made.pregrasp, staged.made.grasp, staged.made.squeeze)
    finite = np.logical_and.reduce([pose.rows(one).finite() for pose in poses])
    checks = failures(
        *(finite, contacts.gaps[one], deep.depth[one], config),
        among_hands=deep.among_hands[one],
        table=deep.table[one],
    )

    reasons = [reason for reason, failed in checks.items() if failed[0]]
    arms = None
    if staged.arm_status is not None and not reasons:
        arms = Status(int(staged.arm_status[row]))
        reasons += [] if arms is Status.OK else [Status.NOT_REACHABLE]

    def per_hand(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        left, right = (values[row, h, : len(hand.contact_names)] for h, hand in enumerate(hands))
        return left, right

    return Finished(
        points=per_hand(contacts.points),
        normals_in=per_hand(contacts.normals_in),
        forces=per_hand(contacts.forces),
        force_scale=staged.made.force_scale[row],
        residual_hand=staged.made.residual_hand[row],
        gaps=per_hand(contacts.gaps),
        among_hands=float(deep.among_hands[row]),
        table=float(deep.table[row]),
        reasons=tuple(reasons),
        arms=arms,
    )
