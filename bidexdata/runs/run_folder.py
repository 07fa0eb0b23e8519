"""Where things lie in a run's folder, and which folder may become one.

Layout: run.json, tasks.parquet, `synth/` (or `import/`, `generated/`) shards with all columns so far,
`validate/<protocol>/<test>/` shards with `grasp_id` and verdict columns beside the protocol's
settings in `validate/<protocol>/protocol.json`, `arms/<rig>/` shards with `grasp_id` and the arms'
motion beside `rig.json`, `logs/`. Verdicts of tests with arms lie in
`validate/<protocol>/a-<rig>/`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import BidexError, Contradiction, NotUsable, PathNotFound
from bidexdata.record.fields import TESTS
from bidexdata.runs.arm_folder import split_folder_name, verdict_folder_name

if TYPE_CHECKING:
    from bidexdata.validation.protocols import Protocol

PLAN_FILE = "tasks.parquet"
PROTOCOL_FILE = "protocol.json"
VALIDATE = "validate"


def rows_folder(run: Path, kind: str) -> Path:
    """Folder of the first stage's shards.

    Args:
        run: The run's folder.
        kind: What run.json says of how the rows came to be.
    """
    return run / (kind if kind in ("synth", "generated") else "import")


def verdict_folder(run: Path, protocol: str, test: str, rig: str = "") -> Path:
    """Folder of the shards of a test's verdicts; tests with arms name the rig."""
    return run / VALIDATE / protocol / verdict_folder_name(test, rig)


def verdict_folders(run: Path, rig: str) -> dict[tuple[str, str], Path]:
    """Folders of verdicts per protocol and test, in their order; with arms, of one rig.

    Nothing else looks into the folder `validate`.
    """
    found = {}
    for folder in sorted(f for f in (run / VALIDATE).glob("*/*") if f.is_dir()):
        test, of_rig = split_folder_name(folder.name)
        if not of_rig or of_rig == rig:
            found[folder.parent.name, test] = folder
    order = {test: place for place, test in enumerate(TESTS)}
    return dict(sorted(found.items(), key=lambda f: (f[0][0], order.get(f[0][1], len(order)))))


def protocol_file(run: Path, protocol: str) -> Path:
    """Where `validate` stores the settings of a protocol."""
    return run / VALIDATE / protocol / PROTOCOL_FILE


def stored_protocol(run: Path, name: str) -> Protocol:
    """Settings of a protocol that a run has verdicts of; else the published one of that name.

    Raises:
        PathNotFound: The run has none of it, and no protocol is called so.
        Contradiction: Its file is damaged.
    """
    from bidexdata.validation.protocols import load_protocol, protocol_from, protocol_names

    path = protocol_file(run, name)
    if not path.is_file():
        if name in protocol_names():
            return load_protocol(name)
        raise PathNotFound(path, "the settings of the protocol that `validate` stores")
    try:
        return protocol_from(json.loads(path.read_text(encoding="utf-8")), str(path))
    except (ValueError, BidexError) as err:
        raise Contradiction(f"{path}: damaged protocol settings ({err})") from err


def refuse_foreign(out: Path, *own: str) -> None:
    """Refuse to start a run in a folder that holds something else.

    What a killed start leaves is no obstacle: a plan, temporary files, and the folders `own`.

    Raises:
        NotUsable: `out` is a file, or holds something else.
    """
    if not out.exists():
        return
    left = {PLAN_FILE, *own}
    if not out.is_dir() or any(
        p.name not in left and not p.name.startswith(".") for p in out.iterdir()
    ):
        raise NotUsable(f"{out} exists and is no run; choose another --out")
