"""Named protocols that judge grasps in simulation: verdicts with reasons, and metrics."""

from bidexdata.validation.backends import on_backend as on_backend
from bidexdata.validation.protocols import Protocol as Protocol
from bidexdata.validation.protocols import load_protocol as load_protocol
from bidexdata.validation.protocols import protocol_names as protocol_names
from bidexdata.validation.validate import Execution as Execution
from bidexdata.validation.validate import validate_grasps as validate_grasps
