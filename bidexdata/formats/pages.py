"""The pages of a release: card, README, attribution, citation and Croissant, in that order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bidexdata.formats import parquet
from bidexdata.formats.attribution import ATTRIBUTION, attribution_text
from bidexdata.formats.card import write_card
from bidexdata.formats.card_words import holds_shapes
from bidexdata.formats.citation import CITATION, About, citation_text
from bidexdata.formats.croissant import write_croissant


class Picture(NamedTuple):
    """One picture of a release."""

    file: str
    """Path within the release."""
    png: bytes
    caption: str


def write_pictures(root: Path, pictures: Sequence[Picture]) -> list[list[str]]:
    """Write pictures into a release; give what the manifest says of them: file and caption."""
    for picture in pictures:
        (root / picture.file).parent.mkdir(exist_ok=True)
        (root / picture.file).write_bytes(picture.png)
    return [[p.file, p.caption] for p in pictures]


def write_pages(root: Path, head: Mapping[str, Any], about: About) -> None:
    """Write everything that people, search engines and reference managers read.

    Args:
        root: Folder whose tables are complete.
        head: The manifest's head (see `writer.write_release`).
        about: Authors, date and address.
    """
    name, version = head["name"], head["version"]
    objects = parquet.read_table(root / "objects.parquet").to_pylist()
    licences = {str(row["licence"]) for row in objects}
    write_card(root, head)
    text = attribution_text(name, version, objects, shapes=holds_shapes(head))
    (root / ATTRIBUTION).write_text(text, encoding="utf-8")
    cited = citation_text(name, version, about, licences)
    (root / CITATION).write_text(cited, encoding="utf-8")
    write_croissant(root, head, about, licences)
