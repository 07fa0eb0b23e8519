"""A chain as URDF text, for an engine that reads no MJCF."""

from __future__ import annotations

import numpy as np

from bidexdata.arms.chain import Chain
from bidexdata.hands.urdf import roll_pitch_yaw


def chain_urdf(chain: Chain) -> str:
    """Links `world`, one per joint, and `end`, the hand frame."""
    links, joints = ["world"], []
    for j, name in enumerate(chain.joint_names):
        links.append(f"link{j}")
        axis = f'<axis xyz="{_text(chain.axis[j])}"/>'
        limit = (
            f'<limit lower="{chain.lower[j]}" upper="{chain.upper[j]}" effort="1" velocity="1"/>'
        )
        place = _origin(chain.before_pos[j], chain.before_rot[j])
        joints.append(_joint(name, "revolute", links[-2], links[-1], place + axis + limit))
    links.append("end")
    place = _origin(chain.end_pos, chain.end_rot)
    joints.append(_joint("end_fixed", "fixed", links[-2], "end", place))
    bodies = "".join(f'<link name="{name}"/>' for name in links)
    return f'<robot name="chain">{bodies}{"".join(joints)}</robot>'


def _joint(name: str, kind: str, parent: str, child: str, rest: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{rest}</joint>'


def _origin(pos: np.ndarray, rot: np.ndarray) -> str:
    return f'<origin xyz="{_text(pos)}" rpy="{_text(roll_pitch_yaw(rot))}"/>'


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in values)
