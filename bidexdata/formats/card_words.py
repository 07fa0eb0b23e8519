"""Sentences of the card that depend on how a release was made: its split, policy and origin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.formats.licences import IDS_ONLY, check_policy
from bidexdata.record.fields import TESTS

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


def tests_of(head: Mapping[str, Any]) -> list[str]:
    """Tests of the default protocol that the release has verdicts of, in their order."""
    return [t for t in TESTS if [head["default_protocol"], t] in [list(k) for k in head["tests"]]]


def success_text(head: Mapping[str, Any]) -> str:
    """Say what counts as a success where a row of the figures does not say."""
    tests, protocol = tests_of(head), head["default_protocol"]
    if not tests:
        return f"Nothing was tested by protocol `{protocol}`."
    return f"Success is test `{tests[0]}` of protocol `{protocol}` unless a row says otherwise."


def arms_text(rig: Mapping[str, Any]) -> str:
    """Describe the rig whose motions `arms/` holds, from its `rig.json`."""
    name = rig["name"]
    licences = ", ".join(f"{side} {m['licence']}" for side, m in sorted(rig["models"].items()))
    about = str(rig["spec"].get("description", ""))
    return (
        f"## Arms\n\n`arms/{name}/` holds, for the same rows in the same order, the motion of two arms "
        f"to each grasp, or the\nstatus that says why there is none. The rig is `{name}`"
        f"{about and ': '}{about}. Licences of the arms'\nmodels, which are not in this release: "
        f"{licences}. `rigs/{name}/rig.json` has the rig, the configuration and\nthe chain of joints "
        "from the world to each hand.\n\n*Reachable*: rows with a motion / the rows of the rate of "
        "test `a`. *Given reachable*: successes / rows with a\nmotion. *Lift given reachable*: those "
        "of them that pass test `l`.\n\n"
    )


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
