"""Sentences of the card that depend on how a release was made: its split, policy and origin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.formats.licences import IDS_ONLY, check_policy

_SPLIT = {
    "object": "By object: no object and no mesh is in two splits",
    "category": "By category: no category and no mesh is in two splits, and objects without a "
    "category train unless one of the same shape tests",
    "size": "By size: whole sizes train or test, so that objects are in both splits",
}
_POLICY = {
    "permissive": "Packed under the policy `permissive`: only objects that may be used for "
    "anything, with at most attribution.",
    "nc-ok": "Packed under the policy `nc-ok`: only objects that may be changed and given on, some "
    "of them for no commercial use or under the same licence only.",
    "ids-only": "Packed under the policy `ids-only`: objects are named, and their meshes are left "
    "out.",
    "": "No licence policy was asked for.",
}


def split_text(split: Mapping[str, Any]) -> str:
    """Say by which rule rows are split."""
    share = f"{100 * split['test_fraction']:.0f} % asked for test, seed {split['seed']}"
    text = f"{_SPLIT[split['by']]}; {share}."
    sizes = [f"{mm} mm" for mm, name in split.get("sizes", {}).items() if name == "test"]
    return text + (f" Sizes that test: {', '.join(sizes)}." if sizes else "")


def policy_text(policy: str) -> str:
    """Say what a licence policy means."""
    return _POLICY[policy]


def holds_shapes(manifest: Mapping[str, Any]) -> bool:
    """Whether a release with this manifest has meshes, pieces and clouds."""
    policy = manifest.get("licences", "")
    if policy:
        check_policy(policy)
    return policy != IDS_ONLY


def derived_text(derived: Mapping[str, Any] | None) -> str:
    """Say which releases this one was made of, and what its rates then mean; empty if of none."""
    if not derived:
        return ""
    named = ", ".join(f"{r['name']} {r['version']}" for r in derived["of"])
    text = {
        "migrate": f"Migrated from {named}: the same rows under a newer schema.",
        "merge": f"Merged from {named}.",
        "split": f"The rows of {named}, split anew.",
        "subset": f"A part of {named}: rows where `{derived.get('where', '')}`.",
    }[derived["how"]]
    if not derived.get("whole_scenes", True):
        text += (
            " Rows were chosen one by one, so their rates say how well the choice was made and "
            "nothing about a generator: there is no unselected rate and no kept share. Attempts are "
            "counted for whole scenes."
        )
    return f"{text}\n\n"
