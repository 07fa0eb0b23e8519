"""Arms: rigs, inverse kinematics and clearance of two arms that carry the hands of a grasp."""

from bidexdata.arms.config import ArmConfig as ArmConfig
from bidexdata.arms.inverse_kinematics import IkConfig as IkConfig
from bidexdata.arms.registry import Rig as Rig
from bidexdata.arms.registry import load_rig as load_rig
from bidexdata.arms.registry import rig_names as rig_names
from bidexdata.arms.robot import Robot as Robot
from bidexdata.arms.robot import mount_robot as mount_robot
from bidexdata.arms.solutions import ArmSolutions as ArmSolutions
from bidexdata.arms.solutions import Targets as Targets
