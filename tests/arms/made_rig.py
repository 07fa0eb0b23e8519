"""A rig of made-up arms of seven joints, of capsules alone: no mesh, no download, any hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

LIMITS = ((-2.9, 2.9), (-2.0, 2.0), (-2.9, 2.9), (-2.0, 2.0), (-2.9, 2.9), (-2.0, 2.0), (-3.0, 3.0))
TURN = {"x": "0.70710678 0.70710678 0 0", "back": "0.70710678 -0.70710678 0 0"}

ARM = """
<mujoco model="made arm">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <geom type="capsule" density="0" group="3"/>
    <joint axis="0 0 1" damping="5" armature="0.1"/>
    <position kp="3000" kv="200"/>
  </default>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="base">
      <geom type="cylinder" size="0.1 0.06" pos="0 0 0.06"/>
      <body name="link1" pos="0 0 0.16">
        <inertial pos="0 0 0.12" mass="5" diaginertia="0.03 0.03 0.02"/>
        <joint name="j1" range="{r[0]}"/>
        <geom size="0.07" fromto="0 0 0 0 0 0.16"/>
        <body name="link2" pos="0 0 0.2" quat="{back}">
          <inertial pos="0 -0.1 0" mass="5" diaginertia="0.03 0.03 0.02"/>
          <joint name="j2" range="{r[1]}"/>
          <geom size="0.065" fromto="0 -0.04 0 0 -0.17 0"/>
          <body name="link3" pos="0 -0.2 0" quat="{x}">
            <inertial pos="0 0 0.1" mass="3" diaginertia="0.02 0.02 0.01"/>
            <joint name="j3" range="{r[2]}"/>
            <geom size="0.06" fromto="0 0 0.02 0 0 0.18"/>
            <body name="link4" pos="0 0 0.22" quat="{x}">
              <inertial pos="0 0.1 0" mass="3" diaginertia="0.02 0.02 0.01"/>
              <joint name="j4" range="{r[3]}"/>
              <geom size="0.055" fromto="0 0.03 0 0 0.15 0"/>
              <body name="link5" pos="0 0.18 0" quat="{back}">
                <inertial pos="0 0 0.1" mass="2" diaginertia="0.01 0.01 0.005"/>
                <joint name="j5" range="{r[4]}"/>
                <geom size="0.05" fromto="0 0 0.02 0 0 0.17"/>
                <body name="link6" pos="0 0 0.2" quat="{back}">
                  <inertial pos="0 -0.03 0" mass="1.5" diaginertia="0.004 0.004 0.003"/>
                  <joint name="j6" range="{r[5]}"/>
                  <geom size="0.05" fromto="0 0 0 0 -0.04 0"/>
                  <body name="link7" pos="0 -0.08 0" quat="{x}">
                    <inertial pos="0 0 0.02" mass="0.5" diaginertia="0.001 0.001 0.001"/>
                    <joint name="j7" range="{r[6]}"/>
                    <geom type="cylinder" size="0.045 0.015" pos="0 0 0.015"/>
                    <site name="flange" pos="0 0 0.03"/>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <keyframe><key name="home" qpos="0 0 0 0 0 0 0"/></keyframe>
</mujoco>
"""


def arm_xml() -> str:
    """The arm's MJCF: upright, seven hinges, 0.9 m long."""
    ranges = [f"{low} {high}" for low, high in LIMITS]
    actuators = "".join(f'<position name="a{j}" joint="j{j}"/>' for j in range(1, 8))
    return ARM.format(r=ranges, actuators=actuators, **TURN)


def rig_data() -> dict:
    """The rig's YAML as plain data: two arms that face each other across the object."""
    turn = np.sqrt(0.5).item()
    joints = {
        f"j{j}": {"lower": low, "upper": high, "velocity": 2.0, "torque": 200.0}
        for j, (low, high) in enumerate(LIMITS, start=1)
    }
    return {
        "name": "made",
        "description": "two made-up arms of capsules that face each other",
        "arm": {
            "source": "arm.xml",
            "licence": "Apache-2.0",
            "flange": "flange",
            "payload": 8.0,
            "joints": joints,
        },
        # Facing -y and +y, so that the world's mirror image y -> -y is that of the arms.
        "left": {
            "pos": [0.0, 0.75, 0.2],
            "quat_wxyz": [turn, 0, 0, -turn],
            "rest": [0.0, 0.5, -0.9, -1.5, 0.7, 1.5, 1.4],
        },
        "right": {
            "pos": [0.0, -0.75, 0.2],
            "quat_wxyz": [turn, 0, 0, turn],
            "rest": [0.0, 0.5, 0.9, -1.5, -0.7, 1.5, -1.4],
        },
        "mounts": {"*": {"pos": [0.05, 0, 0.12], "quat_wxyz": [0, turn, 0, turn]}},
        "fixtures": [
            {"pos": [0, 0.75, 0.05], "half": [0.1, 0.1, 0.15]},
            {"pos": [0, -0.75, 0.05], "half": [0.1, 0.1, 0.15]},
        ],
    }


def write_rig(folder: Path, **changes: object) -> Path:
    """Write the rig and its model to a folder, with other values for some keys at the top."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(arm_xml(), encoding="utf-8")
    path = folder / "made.yaml"
    path.write_text(yaml.safe_dump({**rig_data(), **changes}, sort_keys=False), encoding="utf-8")
    return path
