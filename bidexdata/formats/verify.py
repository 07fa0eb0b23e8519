"""Verify a release: every byte against the manifest, then what the bytes say.

Plain: hashes, stray files, schemas, row counts, place and values of every row, splits, verdict
tables, successes, golden poses by numpy, the card, and where the training form holds its numbers.
Full: also what takes recomputing: content hash, the training form against the tables, shapes, golden
poses by MuJoCo, joint limits, contacts by forward kinematics, every figure, and, where the caller
hands in a simulator, a random sample judged again. docs/verifying.md says what each proves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bidexdata.errors import BidexError, Contradiction, NotUsable
from bidexdata.formats import (
    arm_checks,
    contact_checks,
    content_checks,
    figure_checks,
    golden,
    row_checks,
    table_checks,
    training_checks,
    verdict_checks,
)
from bidexdata.formats.manifest import damage, read_manifest
from bidexdata.formats.release import Release
from bidexdata.formats.verdict_checks import Judged as Judged
from bidexdata.formats.verdict_checks import Resimulate as Resimulate
from bidexdata.wording import counted

Law = tuple[str, Callable[[], str]]


@dataclass(frozen=True, slots=True)
class Check:
    """One law and whether the release keeps it."""

    name: str
    ok: bool
    detail: str
    """What was counted, or the first contradictions."""


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """Every check that was made, in order."""

    path: Path
    full: bool
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """No check failed."""
        return all(check.ok for check in self.checks)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        checks = [{"name": c.name, "ok": c.ok, "detail": c.detail} for c in self.checks]
        return {"path": str(self.path), "ok": self.ok, "full": self.full, "checks": checks}

    def raise_if_bad(self) -> None:
        """Raise the first failures as one sentence.

        Raises:
            Contradiction: A check failed.
        """
        bad = [c for c in self.checks if not c.ok]
        if bad:
            said = "; ".join(f"{c.name}: {c.detail}" for c in bad[:3])
            raise Contradiction(f"{self.path} contradicts its manifest: {said}")


def verify_release(
    path: str | Path,
    *,
    full: bool = False,
    resimulate: Resimulate | None = None,
    sample: int = 8,
    seed: int = 0,
) -> VerifyReport:
    """Check a release and report every law.

    Where files are damaged the later checks are left out, and where plain laws are broken the full
    ones: what they would read is not what was written.

    Args:
        path: Release folder.
        full: Also decode and recompute (see the top of this file).
        resimulate: Judges sampled rows again; left out when None.
        sample: Rows of each test to judge again.
        seed: Seed of the sample.

    Raises:
        PathNotFound: There is no release at `path`.
        NotUsable: `resimulate` needs something that this machine lacks, such as a hand's files.
    """
    release_or_error = _open(Path(path))
    if isinstance(release_or_error, Check):
        return VerifyReport(Path(path), full, (release_or_error,))
    release = release_or_error
    files = _files(release)
    if not files.ok:
        return VerifyReport(release.path, full, (files,))
    checks = [files]
    for laws in (_plain_laws(release), _full_laws(release, resimulate, sample, seed)):
        checks += [_run(name, law) for name, law in laws]
        if not full or not all(check.ok for check in checks):
            break  # recomputing from tables that contradict themselves would only crash
    return VerifyReport(release.path, full, tuple(checks))


def _plain_laws(release: Release) -> list[Law]:
    return [
        ("tables", lambda: table_checks.row_tables(release)),
        ("splits", lambda: table_checks.splits(release)),
        ("hands", lambda: table_checks.hands(release)),
        ("golden", lambda: golden.golden_tree(release)),
        ("rows", lambda: row_checks.rows(release)),
        ("verdict tables", lambda: verdict_checks.verdict_tables(release)),
        *_of_arms(release, ("arms", lambda: arm_checks.arm_rows(release))),
        ("rates", lambda: table_checks.rates(release)),
        ("layout", lambda: training_checks.training_layout(release)),
        ("card", lambda: figure_checks.card(release)),
    ]


def _full_laws(
    release: Release, resimulate: Resimulate | None, sample: int, seed: int
) -> list[Law]:
    laws: list[Law] = [
        ("content hash", lambda: content_checks.content(release)),
        ("shapes", lambda: table_checks.shapes(release)),
        ("golden again", lambda: golden.golden_xml(release)),
        ("training form", lambda: training_checks.training_values(release)),
        ("joint limits", lambda: row_checks.joint_limits(release)),
        *_of_arms(release, ("hands on arms", lambda: arm_checks.arm_poses(release))),
        ("contacts", lambda: contact_checks.contacts(release)),
        ("figures", lambda: figure_checks.figures(release)),
        ("statistics", lambda: content_checks.statistics(release)),
        ("pages", lambda: figure_checks.pages(release)),
    ]
    if resimulate is not None:
        laws.append(
            ("verdicts", lambda: verdict_checks.verdicts(release, resimulate, sample, seed))
        )
    return laws


def _of_arms(release: Release, law: Law) -> list[Law]:
    return [law] if release.rig else []


def _open(path: Path) -> Release | Check:
    try:
        return Release.open(path)
    except Contradiction as err:
        return Check("manifest", False, str(err))


def _files(release: Release) -> Check:
    found = damage(release.path, read_manifest(release.path))
    count = len(release.manifest["files"])
    if found:
        more = f" and {len(found) - 3} more" if len(found) > 3 else ""
        return Check("files", False, "; ".join(found[:3]) + more)
    return Check(
        "files", True, f"sha256 of {counted(count, 'file')} right, none is missing or extra"
    )


def _run(name: str, law: Callable[[], str]) -> Check:
    try:
        return Check(name, True, law())
    except NotUsable:
        raise  # something this machine lacks (a hand, an extra), which says nothing of the release
    except BidexError as err:
        return Check(name, False, str(err))
