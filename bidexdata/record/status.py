"""One enum for everything that can become of an object, an attempt or a test.

A status of one stage never overwrites that of another: `synth_status` and `verdict_status` are
separate columns. Numbers are stored in files: never renumber, only append within a stage's block.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum


class Status(IntEnum):
    """What became of one object (1-19), attempt (20-49), arm solution (50-69) or test (70-99)."""

    OK = 0

    # prepare
    UNREADABLE = 1
    NO_FACES = 2
    NOT_FINITE_MESH = 3
    TOO_COMPLEX = 4
    NO_VOLUME = 5
    DECOMPOSITION_FAILED = 6
    TIMED_OUT = 7
    CRASHED = 8
    DUPLICATE = 9
    UNSUPPORTED = 10
    NOT_SELECTED = 11
    NEAR_DUPLICATE = 12
    NO_FILE = 13

    # synth
    NO_REGION_PAIR = 20
    NO_PLACEMENT = 21
    NOT_FINITE = 22
    PENETRATION_LEFT = 23
    CONTACT_LOST = 24
    SELF_PENETRATION_LEFT = 25
    TABLE_PENETRATION = 26
    JOINT_RANGE = 27

    # arms
    NOT_REACHABLE = 50
    IK_PREGRASP = 51
    IK_GRASP = 52
    IK_LIFT = 53
    JUMP = 54
    COLLISION_TABLE = 55
    COLLISION_OBJECT = 56
    COLLISION_ARMS = 57
    COLLISION_SELF = 58
    NO_GRASP = 59

    # validate
    NOT_RUN = 70
    START_PENETRATION = 71
    NO_CONTACT = 72
    THROWN = 73
    SLIP = 74
    TURNED = 75
    UNSTABLE = 76
    BAD_POSE = 77
    NO_SCENE = 78
    NOT_LIFTED = 79
    BLOWN_UP = 80

    @property
    def sentence(self) -> str:
        """What happened, in words for a person."""
        return _SENTENCES[self]

    @property
    def label(self) -> str:
        """The lower-case name used in reports and `--json` keys."""
        return self.name.lower()


_SENTENCES = {
    Status.OK: "everything succeeded",
    Status.UNREADABLE: "the file could not be read as a mesh",
    Status.NO_FACES: "the file holds no faces",
    Status.NOT_FINITE_MESH: "vertices are not finite numbers or all lie in one point",
    Status.TOO_COMPLEX: "the file needs more memory or time than a stated bound",
    Status.NO_VOLUME: "no closed solid could be made of the mesh",
    Status.DECOMPOSITION_FAILED: "no convex pieces could be made of the mesh",
    Status.TIMED_OUT: "preparing took longer than the time limit; a re-run tries again",
    Status.CRASHED: "the worker that prepared the object died",
    Status.DUPLICATE: "another input file has the same bytes",
    Status.UNSUPPORTED: "the file needs a feature or package that is not supported",
    Status.NOT_SELECTED: "the selection leaves the object out",
    Status.NEAR_DUPLICATE: "an earlier input has nearly the same shape",
    Status.NO_FILE: "there is no such file",
    Status.NO_REGION_PAIR: "no two regions of the object are far enough apart and accessible",
    Status.NO_PLACEMENT: "no pose of the hands clear of each other and the table was found at the regions",
    Status.NOT_FINITE: "the optimisation produced numbers that are not finite",
    Status.PENETRATION_LEFT: "a hand still penetrates the object after the optimisation",
    Status.CONTACT_LOST: "a contact point ended too far from the object's surface",
    Status.SELF_PENETRATION_LEFT: "the hands penetrate themselves or each other",
    Status.TABLE_PENETRATION: "a hand penetrates the table",
    Status.JOINT_RANGE: "joints lie outside the range that the hand allows",
    Status.NOT_REACHABLE: "the arms of the rig that the run was made for cannot take the grasp",
    Status.IK_PREGRASP: "an arm cannot reach the pre-grasp, or the stand-off before it",
    Status.IK_GRASP: "an arm cannot reach the grasp, or the squeeze",
    Status.IK_LIFT: "an arm cannot reach the lifted pose",
    Status.JUMP: "an arm reaches every pose, but not by a continuous motion",
    Status.COLLISION_TABLE: "an arm or a hand meets the table on the way",
    Status.COLLISION_OBJECT: "an arm meets the object, or a hand does before it closes",
    Status.COLLISION_ARMS: "the arms meet each other on the way",
    Status.COLLISION_SELF: "an arm meets itself or what it stands on",
    Status.NO_GRASP: "the attempt has no grasp, so no arm was asked to take it",
    Status.NOT_RUN: "the test was not run: the attempt has no grasp, or its row was left untested",
    Status.START_PENETRATION: "the pre-grasp penetrates deeper than the start check allows",
    Status.NO_CONTACT: "no hand touched the object after closing",
    Status.THROWN: "the object was beyond the limits when the hands had closed",
    Status.SLIP: "the object moved farther than the limit under load",
    Status.TURNED: "the object turned farther than the limit under load",
    Status.UNSTABLE: "the simulation became unstable: numbers that are not finite, or a warning",
    Status.BAD_POSE: "the stored pose is not finite, not a rotation or absurdly far away",
    Status.NO_SCENE: "the simulator refuses to build a scene of the object at this size",
    Status.NOT_LIFTED: "the object stayed on the table when the hands were lifted",
    Status.BLOWN_UP: "the simulation became unstable: something flew faster than is possible",
}


_BEFORE_CLOSING = "the object was beyond the limits before the hands had closed"
"""`THROWN` in the approach of arms, whose hands are still open."""

SYNTH_STAGES = {
    "regions": (Status.NO_REGION_PAIR,),
    "placement": (Status.NO_PLACEMENT,),
    "reach": (Status.NOT_REACHABLE,),
    "optimisation": (Status.NOT_FINITE,),
    "checks": (
        Status.PENETRATION_LEFT,
        Status.SELF_PENETRATION_LEFT,
        Status.TABLE_PENETRATION,
        Status.CONTACT_LOST,
        Status.JOINT_RANGE,
    ),
    "ok": (Status.OK,),
}
"""Stages of the synthesis, and the statuses of attempts that ended there; `ok` came through. The
stage `reach` is one of runs that are made for a rig."""

ARM_STATUSES = tuple(status for status in Status if 50 <= status < 70)
"""Statuses of arms; a verdict that has one of them and no failed stage was not simulated."""


def by_synth_stage(counts: Mapping[str, int]) -> dict[str, int]:
    """Add up attempts by the stage at which they ended, in order; `reach` only where some did.

    Args:
        counts: Attempts per status label.

    >>> by_synth_stage({"ok": 5, "contact_lost": 2, "penetration_left": 1})
    {'regions': 0, 'placement': 0, 'optimisation': 0, 'checks': 3, 'ok': 5}
    """
    ended = {
        stage: sum(counts.get(status.label, 0) for status in statuses)
        for stage, statuses in SYNTH_STAGES.items()
    }
    return {stage: n for stage, n in ended.items() if n or stage != "reach"}


class TestStage(IntEnum):
    """Part of a test in which a grasp failed; the column `failed_stage`."""

    __test__ = False  # no test class, whatever a test runner makes of the name

    NONE = -1
    START = 0
    CLOSING = 1
    LIFT = 2
    HOLD = 3
    APPROACH = 4

    @property
    def label(self) -> str:
        """The lower-case name used in reports."""
        return self.name.lower()


def sentence_at(status: Status, failed_stage: int) -> str:
    """What happened, of a test that failed in a known part of it.

    Args:
        status: The verdict.
        failed_stage: A `TestStage`.

    >>> sentence_at(Status.THROWN, TestStage.APPROACH)
    'the object was beyond the limits before the hands had closed'
    """
    if status is Status.THROWN and failed_stage == TestStage.APPROACH:
        return _BEFORE_CLOSING
    return status.sentence
