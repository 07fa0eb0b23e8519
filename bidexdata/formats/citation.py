"""Who made a data set and when, and `CITATION.cff`, which says so to machines.

Nothing here comes from the clock or the machine: the same arguments give the same bytes.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bidexdata.errors import BadValue
from bidexdata.formats.licences import SPDX

CITATION = "CITATION.cff"


@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """What a person says of a data set; all of it may be missing."""

    authors: tuple[str, ...] = ()
    """`Family, Given`, or the name of a group."""
    date: str = ""
    """Day of the release, YYYY-MM-DD."""
    url: str = ""
    """Address where the data set is found."""

    def __post_init__(self):
        if self.date:
            try:
                if datetime.date.fromisoformat(self.date).isoformat() != self.date:
                    raise ValueError(self.date)
            except ValueError as err:
                raise BadValue(f"date {self.date!r} cannot be used; write YYYY-MM-DD") from err
        if self.url and not self.url.startswith(("https://", "http://")):
            raise BadValue(f"url {self.url!r} cannot be used; write an address, https://...")
        if any(not author.strip(" ,") for author in self.authors):
            raise BadValue("an author has no name; write --author 'Family, Given'")

    def creators(self, name: str) -> list[dict[str, str]]:
        """Authors as Citation File Format has them: persons, and entities that have one name.

        >>> About(authors=("Curie, Marie", "Radium Institute")).creators("x")
        [{'family-names': 'Curie', 'given-names': 'Marie'}, {'name': 'Radium Institute'}]
        """
        found = []
        for author in self.authors or (f"The authors of {name}",):
            family, comma, given = (part.strip() for part in author.partition(","))
            person = {"family-names": family, "given-names": given}
            found.append(person if comma and given else {"name": family})
        return found

    def manifest(self) -> dict[str, Any]:
        """What the manifest keeps, so that a release made of this one can say it too."""
        return {"authors": list(self.authors), "date": self.date, "url": self.url}

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> About:
        """What a manifest says; older ones say nothing."""
        said = manifest.get("about", {})
        return cls(
            authors=tuple(said.get("authors", ())),
            date=said.get("date", ""),
            url=said.get("url", ""),
        )


def citation_text(name: str, version: str, about: About, licences: Iterable[str]) -> str:
    """Contents of `CITATION.cff`, format 1.2.0.

    Args:
        name: Of the data set.
        version: Its version.
        about: Creators, date and address.
        licences: SPDX identifiers of the objects; left out unless all are known.
    """
    import yaml

    known = sorted(set(licences))
    data: dict[str, Any] = {
        "cff-version": "1.2.0",
        "message": "If you use this data set, please cite it as below.",
        "type": "dataset",
        "title": name,
        "version": version,
        "authors": about.creators(name),
        "keywords": ["dexterous grasping", "robotics", "bidexdata"],
    }
    if about.date:
        data["date-released"] = about.date
    if about.url:
        data["url"] = about.url
    if known and all(licence in SPDX for licence in known):
        data["license"] = known if len(known) > 1 else known[0]
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
