"""Licences of meshes: SPDX identifiers, the words people use for them, and what a release may hold.

A release gives meshes away in a changed form: repaired, and cut into convex pieces. So a licence
that forbids changes (ND) forbids that too, and so does the absence of a licence. Such objects may
be in a release by name, hash and recipe only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal, get_args

from bidexdata.errors import UnknownChoice

Policy = Literal["permissive", "nc-ok", "ids-only"]
POLICIES: tuple[Policy, ...] = get_args(Policy)
IDS_ONLY: Policy = "ids-only"
UNKNOWN = "unknown"
"""Licence that nobody stated, or that is none of `SPDX`."""

PERMISSIVE = (
    "0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC-BY-1.0", "CC-BY-2.0",
    "CC-BY-2.5", "CC-BY-3.0", "CC-BY-4.0", "CC-PDDC", "CC0-1.0", "CDLA-Permissive-1.0",
    "CDLA-Permissive-2.0", "ISC", "MIT", "MIT-0", "ODC-By-1.0", "PDDL-1.0", "Unlicense", "Zlib",
)  # fmt: skip
"""Any use, with at most attribution."""
SHARE_ALIKE = (
    "AGPL-3.0-only", "AGPL-3.0-or-later", "CC-BY-SA-1.0", "CC-BY-SA-2.0", "CC-BY-SA-2.5",
    "CC-BY-SA-3.0", "CC-BY-SA-4.0", "CDLA-Sharing-1.0", "GPL-2.0-only", "GPL-2.0-or-later",
    "GPL-3.0-only", "GPL-3.0-or-later", "LGPL-2.1-only", "LGPL-2.1-or-later", "LGPL-3.0-only",
    "LGPL-3.0-or-later", "MPL-2.0", "ODbL-1.0",
)  # fmt: skip
"""Any use, but what is made of them must be given on under the same licence."""
NON_COMMERCIAL = (
    "CC-BY-NC-1.0", "CC-BY-NC-2.0", "CC-BY-NC-2.5", "CC-BY-NC-3.0", "CC-BY-NC-4.0",
    "CC-BY-NC-SA-1.0", "CC-BY-NC-SA-2.0", "CC-BY-NC-SA-2.5", "CC-BY-NC-SA-3.0", "CC-BY-NC-SA-4.0",
)  # fmt: skip
"""Changed copies may be given on, for no commercial use."""
NO_CHANGES = (
    "CC-BY-NC-ND-1.0", "CC-BY-NC-ND-2.0", "CC-BY-NC-ND-2.5", "CC-BY-NC-ND-3.0", "CC-BY-NC-ND-4.0",
    "CC-BY-ND-1.0", "CC-BY-ND-2.0", "CC-BY-ND-2.5", "CC-BY-ND-3.0", "CC-BY-ND-4.0",
)  # fmt: skip
"""Changed copies may not be given on."""
SPDX = (*PERMISSIVE, *SHARE_ALIKE, *NON_COMMERCIAL, *NO_CHANGES)
"""Identifiers that are known. Source: the SPDX licence list."""

_GIVEN_ON: dict[str, tuple[str, ...]] = {
    "permissive": PERMISSIVE,
    "nc-ok": (*PERMISSIVE, *SHARE_ALIKE, *NON_COMMERCIAL),
}
_ALIASES = {
    "apache": "Apache-2.0",
    "apache-2": "Apache-2.0",
    "bsd-2": "BSD-2-Clause",
    "bsd-3": "BSD-3-Clause",
    "cc-0": "CC0-1.0",
    "cc0": "CC0-1.0",
    "cc-zero": "CC0-1.0",
    "cc-zero-1.0": "CC0-1.0",
    "gpl-2.0": "GPL-2.0-only",
    "gpl-3.0": "GPL-3.0-only",
    "lgpl-2.1": "LGPL-2.1-only",
    "lgpl-3.0": "LGPL-3.0-only",
    "agpl-3.0": "AGPL-3.0-only",
    "odbl": "ODbL-1.0",
    "odc-odbl": "ODbL-1.0",
    "odc-by": "ODC-By-1.0",
    "pddl": "PDDL-1.0",
    "public-domain": "CC-PDDC",
    "publicdomain": "CC-PDDC",
}
"""Words in the form of `_plain`. A Creative Commons licence without its version stays unknown: the
versions differ."""
_BY_PLAIN = {name.lower(): name for name in SPDX} | _ALIASES
_WORDS = (
    (r"creative[- ]commons", "cc"),
    (r"attribution", "by"),
    (r"non-?commercial", "nc"),
    (r"no-?deriv(ative)?s?(-works)?", "nd"),
    (r"share-?alike", "sa"),
)
_ADDRESS = re.compile(r"https?://(?:www\.)?creativecommons\.org/(licenses|publicdomain)/([^/]+)/([\d.]+)")  # fmt: skip


def normal_licence(text: object) -> str:
    """Give the SPDX identifier that a text means; `unknown` where it is none that we know.

    Examples:
        >>> normal_licence("cc by-nc 4.0"), normal_licence("Apache License, Version 2.0")
        ('CC-BY-NC-4.0', 'Apache-2.0')
        >>> normal_licence("https://creativecommons.org/licenses/by-sa/4.0/")
        'CC-BY-SA-4.0'
        >>> normal_licence("Zlib (Bullet)")  # a remark behind it, such as whose it is
        'Zlib'
        >>> normal_licence("all rights reserved"), normal_licence(None)
        ('unknown', 'unknown')
    """
    words = str(text or "").strip()
    address = _ADDRESS.match(words.lower())
    if address:
        kind, name, version = address.groups()
        words = f"cc0-{version}" if name == "zero" else f"cc-{name}-{version}"
        words = "public-domain" if kind == "publicdomain" and name == "mark" else words
    without_remark = re.sub(r"\s*\([^()]*\)$", "", words)
    return _BY_PLAIN.get(_plain(words)) or _BY_PLAIN.get(_plain(without_remark), UNKNOWN)


def allows(licence: object, policy: str) -> bool:
    """Whether a release of a policy may hold meshes under a licence.

    Args:
        licence: An SPDX identifier or a text for one.
        policy: `permissive` (any use), `nc-ok` (non-commercial and share-alike licences too) or
            `ids-only`, under which every object may be named, but no mesh is in the release.

    Raises:
        UnknownChoice: No policy is called so.
    """
    check_policy(policy)
    return policy == IDS_ONLY or normal_licence(licence) in _GIVEN_ON[policy]


def check_policy(policy: str) -> None:
    """Refuse a policy that there is not.

    Raises:
        UnknownChoice: No policy is called so.
    """
    if policy not in POLICIES:
        raise UnknownChoice("--licences", policy, POLICIES)


def licence_address(licence: str) -> str:
    """Address of a licence's text; empty for an unknown one.

    >>> licence_address("CC-BY-4.0")
    'https://spdx.org/licenses/CC-BY-4.0'
    """
    return f"https://spdx.org/licenses/{licence}" if licence in SPDX else ""


def hub_licence(licences: Iterable[str]) -> str:
    """The word of Hugging Face's hub for the licences of all objects: `other` for several.

    Its identifiers are the lower-case SPDX ones, for the licences that it knows.
    """
    known = {licence.lower() for licence in licences}
    only = known.pop() if len(known) == 1 else ""
    return only if only in _HUB else "other"


_HUB = (
    "apache-2.0", "mit", "bsd-3-clause", "bsd-2-clause", "cc0-1.0", "cc-by-2.0", "cc-by-3.0",
    "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0",
    "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0", "cc-by-nc-sa-4.0", "unlicense", "pddl", "zlib", "isc",
)  # fmt: skip


def _plain(text: str) -> str:
    words = text.lower().replace("_", "-").replace("(", " ").replace(")", " ")
    words = re.sub(
        r"\bthe\b|\blicen[cs]e[ds]?\b|\bversion\b|\bv(?=\d)|\b(?:international|universal|unported|generic)\b|,",
        " ",
        words,
    )
    for pattern, short in _WORDS:
        words = re.sub(pattern, short, words)
    words = re.sub(r"[\s/-]+", "-", words).strip("-.")
    words = re.sub(r"^(by|nc|nd|sa)\b", r"cc-\1", words)
    # "cc-by-nc-4": a whole version is written as X.0.
    return re.sub(r"^((?:cc|apache|mpl|gpl|lgpl|agpl)[a-z-]*-\d)$", r"\1.0", words)
