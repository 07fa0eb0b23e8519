"""Names of hands, and how a name and a side become a `Hand`.

A name is a spec in `hands/specs/`, or the path of a user's YAML spec. Loading is cached: the sphere
fit takes about a second per hand, which a hand that is only drawn goes without.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from bidexdata.config import named_yaml
from bidexdata.errors import BadConfig
from bidexdata.hands.assemble import drawn_hand, mirrored_hand, written_hand
from bidexdata.hands.model import Hand, Side
from bidexdata.hands.spec import HandSpec, read_spec

_SPECS = Path(__file__).parent / "specs"


def hand_names() -> tuple[str, ...]:
    """Names of the hands that come with the package, in alphabetical order."""
    return tuple(sorted(p.stem for p in _SPECS.glob("*.yaml") if not p.stem.endswith("_links")))


def hand_spec(name: str | Path) -> HandSpec:
    """Read the spec of a named hand or of a YAML file.

    Raises:
        UnknownName: No hand has this name and no file this path.
        BadConfig: The spec is not usable.
    """
    return read_spec(spec_path(str(name)))


def load_hands(name: str) -> tuple[Hand, Hand]:
    """Load the left and the right hand.

    Args:
        name: One name or spec path for both sides, or `LEFT,RIGHT`.

    Raises:
        UnknownName: A name does not exist.
        NotUsable: A model cannot be had or does not fit its spec.
    """
    names = [part.strip() for part in name.split(",")]
    if len(names) > 2 or not all(names):
        raise BadConfig(f"--hand {name!r}: give NAME or LEFT,RIGHT")
    return load_hand(names[0], "left"), load_hand(names[-1], "right")


def load_hand(name: str | Path, side: Side) -> Hand:
    """Load one hand of one side, by name or by the path of a YAML spec.

    Raises:
        UnknownName: No hand has this name and no file this path.
        NotUsable: The model cannot be had, or does not fit the spec.
    """
    path = _path_of(name, side)
    return _load(path, side, path.stat().st_mtime_ns)


def load_drawn(name: str | Path, side: Side) -> Hand:
    """Load one hand as far as it is drawn: kinematics and shapes, no contact points, no spheres.

    Raises:
        UnknownName: No hand has this name and no file this path.
        NotUsable: The model cannot be had, or does not fit the spec.
    """
    path = _path_of(name, side)
    return _load_drawn(path, side, path.stat().st_mtime_ns)


def spec_path(name: str) -> Path:
    """Find the YAML file of a named hand, or of a path.

    Raises:
        UnknownName: No hand has this name and no file this path.
    """
    return named_yaml("hand", name, hand_names(), _SPECS)


def _path_of(name: str | Path, side: Side) -> Path:
    if side not in ("left", "right"):
        raise BadConfig(f"a hand's side is left or right, not {side!r}")
    return spec_path(str(name))


@lru_cache(maxsize=16)
def _load_drawn(path: Path, side: Side, modified: int) -> Hand:
    return drawn_hand(read_spec(path), side, path.parent)


@lru_cache(maxsize=16)
def _load(path: Path, side: Side, modified: int) -> Hand:
    spec = read_spec(path)
    if side == spec.written_for:
        return written_hand(spec, path.parent)
    return mirrored_hand(spec, _load(path, spec.written_for, modified), path.parent)
