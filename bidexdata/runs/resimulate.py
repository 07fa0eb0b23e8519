"""Judge rows of a release again, for `verify --full`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.errors import MissingExtra
from bidexdata.formats.manifest import sha256_of
from bidexdata.kinds import MANIFEST

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.formats.verify import Judged
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid
    from bidexdata.record import GraspBatch, HandHeader


class ReleaseHands(NamedTuple):
    """The hands that rows of a release are judged with."""

    hands: tuple[Hand, ...]
    borrowed: tuple[str, ...]
    """Names of those that come from this installation, not from the release."""


def resimulate(release: Release, batch: GraspBatch, solid: Solid, test: str) -> Judged:
    """Run a test of the release's default protocol, by its stored settings, on rows of one object.

    Raises:
        NotUsable: Neither the release nor this installation has a hand.
        MissingExtra: MuJoCo is not installed.
    """
    try:
        import mujoco  # noqa: F401
    except ImportError as err:
        raise MissingExtra("mujoco", "synth") from err
    from bidexdata.formats.verify import Judged
    from bidexdata.validation.protocols import load_protocol, protocol_from
    from bidexdata.validation.validate import validate_grasps

    found = release_hands(release)
    name = release.default_protocol
    stored = release.protocol_settings.get(name)
    where = f"{release.path}/manifest.json: protocol {name}"
    protocol = load_protocol(name) if stored is None else protocol_from(stored, where)
    success = validate_grasps(batch, solid, found.hands, protocol, test)["success"]
    named = " and ".join(dict.fromkeys(found.borrowed))
    note = f", the hand {named} being that of this installation" if found.borrowed else ""
    return Judged(success, note)


def release_hands(release: Release) -> ReleaseHands:
    """Give the hands of a release: its own, or where that cannot be those of this installation.

    A hand with meshes is the release's own where this installation has the mesh files that the
    release names, by their hashes.

    Raises:
        NotUsable: Neither has a hand, or its joints are others here.
    """
    return _hands(release.path, release.hands, sha256_of(release.path / MANIFEST))


@lru_cache(maxsize=2)
def _hands(root: Path, headers: tuple[HandHeader, ...], seal: str) -> ReleaseHands:
    # The seal keeps a release that took another's place from getting the other's hands.
    from bidexdata.formats.hand_files import hand_folder
    from bidexdata.formats.stored_hand import stored_hand
    from bidexdata.runs.installed import hand_here

    hands, borrowed = [], []
    for header in headers:
        folder = root / hand_folder(header.name, header.side)
        hand = stored_hand(folder, {})
        if hand is None:
            here = hand_here(header, root)
            hand = stored_hand(folder, here.make_spec().assets)
            if hand is None:
                borrowed.append(header.name)
                hand = here
        hands.append(hand)
    return ReleaseHands(tuple(hands), tuple(borrowed))
