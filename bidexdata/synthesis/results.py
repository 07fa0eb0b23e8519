"""What the stages of the synthesis hand on: grasps as found, looked at, and sorted out per scene.

Letters: K starts of all scenes, M attempts of one scene, C contact points of a hand; 2 is left, right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int8, Int16

from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.readout import Energies
from bidexdata.synthesis.settling import Settled


class Overlaps(NamedTuple):
    """Deepest overlaps on the hands' own geometry [m], zero or more; NaN where not finite."""

    depth: Float[np.ndarray, " K"]
    """Hands and object at the pre-grasp."""
    among_hands: Float[np.ndarray, " K"]
    """Within a hand or between hands at the pre-grasp."""
    table: Float[np.ndarray, " K"]
    """Hands and table at the stage where they are deepest in it; 0 without one."""


class GraspContacts(NamedTuple):
    """Contacts at the grasps, object frame; behind those of an attempt's set NaN, indices -1."""

    number: Int16[np.ndarray, "K 2 C"]
    """Which of the hand's contact points each is."""
    points: Float[np.ndarray, "K 2 C 3"]
    """Surface points under the pads [m]."""
    normals_in: Float[np.ndarray, "K 2 C 3"]
    """Inward unit normals there."""
    gaps: Float[np.ndarray, "K 2 C"]
    """Signed distances of the pads from the surface [m]."""
    forces: Float[np.ndarray, "K 2 C 3"]
    """Forces on the object of the coupled zero-load QP [caps]."""


class Made(NamedTuple):
    """Grasps of all scenes as they were found, in the order of the starts."""

    pregrasp: Pose
    grasp: Pose
    squeeze: Pose
    energies: Energies
    """At the grasp."""
    contacts: GraspContacts
    residual: Float[np.ndarray, " K"]
    """Coupled zero-load QP residual [-]."""
    residual_hand: Float[np.ndarray, "K 2"]
    """The same of each hand alone [-]."""
    shifted: Float[np.ndarray, " K"]
    """Residual of moved contacts [-]."""
    force_scale: Float[np.ndarray, "K 2"]
    """[N] per unit of force."""

    @property
    def stages(self) -> tuple[Pose, Pose, Pose]:
        """Pre-grasp, grasp and squeeze."""
        return self.pregrasp, self.grasp, self.squeeze


class Staged(NamedTuple):
    """The same grasps, looked at."""

    made: Made
    settled: Settled
    """How the object lies when the hands have closed, each (K,)."""
    overlaps: Overlaps
    """Each (K,)."""
    status: Int8[np.ndarray, " K"]
    arm_status: Int8[np.ndarray, " K"] | None = None
    """What the arms of the rig come to, NO_GRASP where a grasp failed before; None without a rig."""


class Outcome(NamedTuple):
    """What became of all M attempts of a scene; NaN where there is no start or no finite pose."""

    status: Int8[np.ndarray, " M"]
    depth: Float[np.ndarray, " M"]
    """Pre-grasp penetration [m]."""
    residual: Float[np.ndarray, " M"]
    """Coupled zero-load QP residual [-]."""
    shifted: Float[np.ndarray, " M"]
    """Residual of moved contacts [-]."""
    settled: Settled
    """How the object lies when the hands have closed, each (M,)."""
    doubt: Float[np.ndarray, " M"]
    """What the order is by, least first."""
    places: Float[np.ndarray, "M 2 3"]
    """Origins of the hand frames at the grasp, object frame [m]."""
    selected: Bool[np.ndarray, " M"]
    """One of the best."""
    audit: Bool[np.ndarray, " M"]
    """One of those drawn beforehand."""
