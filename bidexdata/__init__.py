"""Turn mesh files into published, verified, trainable datasets of two-handed dexterous grasps.

The public names below are imported when they are first used, so that `import bidexdata` is light
and reading a release needs none of the packages that make one. A name that needs a package which
is not installed raises `MissingExtra`, which says what to install.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name -> the module that defines it.
_PUBLIC = {
    "BiDexDataset": "bidexdata.loaders.dataset",
    "GraspBatch": "bidexdata.record",
    "Hand": "bidexdata.hands.model",
    "HandModel": "bidexdata.hands.torch_layer",
    "ImportRequest": "bidexdata.runs.import_",
    "Library": "bidexdata.objects.library",
    "Release": "bidexdata.formats.release",
    "Run": "bidexdata.runs.run",
    "SynthRequest": "bidexdata.runs.synth",
    "TaskExecution": "bidexdata.runs.stage",
    "describe": "bidexdata.runs.info",
    "import_run": "bidexdata.runs.import_",
    "load_hand": "bidexdata.hands",
    "load_hands": "bidexdata.hands",
    "load_preset": "bidexdata.synthesis.presets",
    "load_protocol": "bidexdata.validation.protocols",
    "object_interval": "bidexdata.record.intervals",
    "pack_runs": "bidexdata.runs.pack",
    "prepare_library": "bidexdata.runs.prepare",
    "prepare_object": "bidexdata.objects.prepare",
    "render": "bidexdata.runs.render",
    "synth_library": "bidexdata.runs.synth",
    "synthesize": "bidexdata.synthesis.pipeline",
    "validate_grasps": "bidexdata.validation.validate",
    "validate_run": "bidexdata.runs.validate",
    "verify_release": "bidexdata.formats.verify",
    "write_table": "bidexdata.runs.table",
}

if TYPE_CHECKING:
    from bidexdata.formats.release import Release as Release
    from bidexdata.formats.verify import verify_release as verify_release
    from bidexdata.hands import load_hand as load_hand
    from bidexdata.hands import load_hands as load_hands
    from bidexdata.hands.model import Hand as Hand
    from bidexdata.hands.torch_layer import HandModel as HandModel
    from bidexdata.loaders.dataset import BiDexDataset as BiDexDataset
    from bidexdata.objects.library import Library as Library
    from bidexdata.objects.prepare import prepare_object as prepare_object
    from bidexdata.record import GraspBatch as GraspBatch
    from bidexdata.record.intervals import object_interval as object_interval
    from bidexdata.runs.import_ import ImportRequest as ImportRequest
    from bidexdata.runs.import_ import import_run as import_run
    from bidexdata.runs.info import describe as describe
    from bidexdata.runs.pack import pack_runs as pack_runs
    from bidexdata.runs.prepare import prepare_library as prepare_library
    from bidexdata.runs.render import render as render
    from bidexdata.runs.run import Run as Run
    from bidexdata.runs.stage import TaskExecution as TaskExecution
    from bidexdata.runs.synth import SynthRequest as SynthRequest
    from bidexdata.runs.synth import synth_library as synth_library
    from bidexdata.runs.table import write_table as write_table
    from bidexdata.runs.validate import validate_run as validate_run
    from bidexdata.synthesis.pipeline import synthesize as synthesize
    from bidexdata.synthesis.presets import load_preset as load_preset
    from bidexdata.validation.protocols import load_protocol as load_protocol
    from bidexdata.validation.validate import validate_grasps as validate_grasps


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'bidexdata' has no attribute {name!r}")
    try:
        return getattr(import_module(_PUBLIC[name]), name)
    except ModuleNotFoundError as err:
        from bidexdata.extras import missing_extra

        missing = missing_extra(err)
        if missing is None:
            raise
        raise missing from err


def __dir__() -> list[str]:
    return sorted(["__version__", *_PUBLIC])
