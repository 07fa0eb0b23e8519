"""What a run was made of: a library or a release, hands, and a rig; refused where it has changed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from bidexdata.errors import ConfigConflict, PathNotFound, SourceChanged
from bidexdata.kinds import MANIFEST, RUN_FILE
from bidexdata.runs.arm_folder import check_robot, known_spheres, read_record, resolve_spec
from bidexdata.runs.spec import RunSpec

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands import Hand, Side
    from bidexdata.objects.library import Library


def source_folder(run: Path, spec: RunSpec) -> Path:
    """Folder of the library, or of the release that is re-tested.

    Raises:
        PathNotFound: It is not where run.json says.
    """
    path = (run / spec.source).resolve()
    if not path.is_dir():
        wanted = "the release" if spec.of_release else "the library"
        raise PathNotFound(path, f"{wanted} that {run / RUN_FILE} names")
    return path


def open_library(run: Path, spec: RunSpec) -> Library:
    """Open the library that a run was made from.

    Raises:
        PathNotFound: It is not where run.json says.
        SourceChanged: It has changed since.
    """
    from bidexdata.objects.library import Library

    library = Library.open(source_folder(run, spec))
    if library.fingerprint != spec.source_fingerprint:
        change = f"{spec.source_fingerprint!r} -> {library.fingerprint!r}"
        raise SourceChanged(run, library.path, change)
    return library


def check_release(run: Path, spec: RunSpec) -> None:
    """Refuse a release that has changed since a run of its rows or objects was made.

    Raises:
        PathNotFound: It is not where run.json says.
        SourceChanged: It is there and holds something else.
    """
    from bidexdata.formats.manifest import sha256_of

    source = source_folder(run, spec)
    found = sha256_of(source / MANIFEST)[:16]
    if found != spec.source_fingerprint:
        change = f"{spec.source_fingerprint!r} -> {found!r}"
        raise SourceChanged(run, source, change, "release")


def hands_of(run: Path, spec: RunSpec, *, drawn: bool = False) -> tuple[Hand, ...]:
    """Load the hands of a run, in the order of the H axis.

    Args:
        run: The run's folder.
        spec: What its run.json says.
        drawn: Only as far as they are drawn, which is sooner.

    Raises:
        ConfigConflict: A hand's spec or files have changed since the run was made.
    """
    from bidexdata.hands import load_drawn, load_hand

    load = load_drawn if drawn else load_hand
    names = [resolve_spec(n.strip(), run) for n in spec.hand.split(",")]
    hands = []
    for number, header in enumerate(spec.hands):
        hand = load(names[min(number, len(names) - 1)], cast("Side", header.side))
        if hand.spec_hash != header.spec_hash:
            change = f"{header.spec_hash[:12]!r} -> {hand.spec_hash[:12]!r}"
            raise ConfigConflict(run, [f"hands.{header.side}.spec_hash: {change}"])
        hands.append(hand)
    return tuple(hands)


def robot_of(run: Path, rig: str, hands: tuple[Hand, ...]) -> Robot:
    """Load a rig with a run's hands, as the arm solutions were made with.

    Raises:
        NotUsable: The rig's models cannot be had.
        ConfigConflict: The rig, its models or a hand have changed since.
    """
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot

    record = read_record(run, rig)
    known = partial(known_spheres, run, record.name)
    robot = mount_robot(load_rig(resolve_spec(record.rig, run)), hands, known)
    check_robot(run, record, robot)
    return robot
