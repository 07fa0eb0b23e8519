"""Boxes with grasps whose arms move, of a made-up rig; nothing is solved."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
from picture_samples import Made

sys.path.insert(0, str(Path(__file__).parents[1] / "arms"))

from made_rig import write_rig

from bidexdata.arms.config import ArmConfig
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import mount_robot
from bidexdata.arms.solutions import arm_headers, no_solutions
from bidexdata.record import GraspBatch, Status

CONFIG = ArmConfig()
FAILED = 2
"""The row whose arms have no motion; the second of those of 300 mm."""


class Armed(Made):
    """Rows whose arms sway from their rest; made so that each takes another time."""

    rig = "made"

    def __init__(self, hands, robot):
        super().__init__(hands)
        self._robot = robot

    def robot(self):
        return self._robot

    def arms(self, object_id):
        batch, robot = self.batches[object_id], self._robot
        found = no_solutions(robot, CONFIG, len(batch), Status.OK)
        knots = found.arm_time.shape[1]
        for h, arm in enumerate(robot.arms):
            sway = 0.5 * np.sin(np.linspace(0, np.pi, knots))[:, None]
            found.arm_path[:, h, :, : arm.chain.joints] = arm.chain.rest + sway
        found.arm_time[:] = np.arange(knots) * (0.05 + 0.01 * np.arange(len(batch))[:, None])
        found.arm_step[:], found.clear_table[:] = 0.05, 0.0123
        found.arm_status[FAILED], found.arm_path[FAILED] = Status.JUMP, np.nan
        header = dataclasses.replace(batch.header, arms=arm_headers(robot, CONFIG))
        return GraspBatch(header, {**batch.columns, **found.to_columns()})


def armed_source(hands, folder: Path) -> Armed:
    """The boxes, with the made-up rig in a folder."""
    return Armed(hands, mount_robot(load_rig(write_rig(folder)), hands))
