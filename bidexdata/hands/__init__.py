"""Hands: from a YAML spec to flat arrays, kinematics on every engine, and drawing meshes."""

from bidexdata.hands.model import Hand as Hand
from bidexdata.hands.model import Side as Side
from bidexdata.hands.registry import hand_names as hand_names
from bidexdata.hands.registry import load_drawn as load_drawn
from bidexdata.hands.registry import load_hand as load_hand
from bidexdata.hands.registry import load_hands as load_hands
