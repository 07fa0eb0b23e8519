"""The record that flows through all stages: field table, statuses, batches."""

from bidexdata.record.batch import GraspBatch as GraspBatch
from bidexdata.record.batch import HandHeader as HandHeader
from bidexdata.record.batch import Header as Header
from bidexdata.record.fields import FIELDS as FIELDS
from bidexdata.record.fields import Field as Field
from bidexdata.record.scene import Scene as Scene
from bidexdata.record.status import Status as Status
