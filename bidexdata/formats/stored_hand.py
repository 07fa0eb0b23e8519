"""A hand as a release holds it: arrays from `tree.json`, geometry from `hand.xml`.

A release names the mesh files of a hand and holds their hashes, not the files. A hand without
meshes is whole; one with meshes is so where the caller has files of these hashes.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import Contradiction
from bidexdata.formats.hand_files import compiled_hashes
from bidexdata.hands.tree_file import hand_of_tree

if TYPE_CHECKING:
    import mujoco

    from bidexdata.hands.model import Hand


def stored_hand(folder: Path, assets: Mapping[str, bytes]) -> Hand | None:
    """Build a hand from `hands/<name>/<side>` of a release.

    Args:
        folder: That folder.
        assets: Files by name or path; those that `hand.xml` names are taken by their last part.

    Returns:
        The hand; None where a mesh file is missing or another than the release's, or where an older
        version wrote the folder.

    Raises:
        Contradiction: The folder's files cannot be read as a hand.
    """
    try:
        tree = json.loads((folder / "tree.json").read_text(encoding="utf-8"))
        xml = (folder / "hand.xml").read_text(encoding="utf-8")
        wanted = {e.attrib["file"] for e in ET.fromstring(xml).iter() if "file" in e.attrib}
        known = {Path(name).name: data for name, data in assets.items()}
        if "prefix" not in tree or not wanted <= set(known):
            return None
        make_spec = _maker(xml, {name: known[name] for name in sorted(wanted)})
        made = {row["mesh"]: row["compiled_sha256"] for row in tree["assets"]}
        if compiled_hashes(make_spec().compile()) != made:
            return None
        return hand_of_tree(tree, make_spec)
    except (OSError, ValueError, KeyError, TypeError, ET.ParseError) as err:
        raise Contradiction(f"{folder}: unreadable hand ({err!r})") from err


def _maker(xml: str, assets: Mapping[str, bytes]) -> Callable[[], mujoco.MjSpec]:
    def make_spec() -> mujoco.MjSpec:
        import mujoco

        return mujoco.MjSpec.from_string(xml, assets=dict(assets))

    return make_spec
