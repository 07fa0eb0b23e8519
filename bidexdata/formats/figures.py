"""Figures of a set of grasps: counts, statuses, rates per size, means of the metrics per group.

Definitions. N = grasps to keep per scene. *Unselected rate* = successes / N over the audit rows:
every status other than OK is a failure, and a scene that could not fill its audit rows counts the
missing ones as failures. *Selected rate* = successes / selected rows. *Kept share* = selected rows
/ (N x scenes); a scene of two runs counts twice here, and once among `scenes`. *Object success* =
scenes with a selected row that passed / scenes with a selected row. Rates count only rows of runs
that were tested. Metrics are means over selected rows where they were measured; `pd`,
`spd` and `cdc` are those of the first test that was run (they do not depend on the test).

Tests with arms, besides: *reachable* = rows with a motion of the arms / the same rows; *given
reachable* = successes / rows with a motion, so that the product of both is the rate itself; *lift given
reachable* = those of them that pass test l, whose hands no arm carries.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from bidexdata.formats.attempts import AttemptTally
from bidexdata.formats.diversity import DiversityTally, finite_vectors
from bidexdata.formats.groups import BOUNDED, GroupTally, hands_label
from bidexdata.formats.reach import arm_rates, arm_rates_of, arm_trials
from bidexdata.formats.trials import TrialTally
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import HEADLINE
from bidexdata.record.rates import Rate, clustered_interval
from bidexdata.record.scene import SceneParts, scene_parts
from bidexdata.wording import counted


class Tally:
    """Add batches of any size, then read `figures()`.

    State: counts per (test, size, object), scenes, statuses, moments of metrics; nothing per grasp.
    """

    def __init__(self, tests: tuple[str, ...] = ("f",)):
        self.tests = tests
        self._scenes: dict[tuple[str, str], SceneParts] = {}
        self._kept_of: set[str] = set()  # scenes with a selected row
        self._rows: Counter[str] = Counter()
        self._attempts = AttemptTally()
        self._verdicts: dict[str, Counter[str]] = {t: Counter() for t in tests}
        self._chosen_verdicts: dict[str, Counter[str]] = {t: Counter() for t in tests}
        self._trials = TrialTally()
        self._groups = {t: GroupTally() for t in tests}
        # test -> object -> scene -> whether a selected row passed
        self._won: dict[str, dict[str, dict[str, bool]]] = {
            t: defaultdict(lambda: defaultdict(bool)) for t in tests
        }
        self._diversity: dict[int | None, DiversityTally] = defaultdict(DiversityTally)
        self._audit_diversity: dict[int | None, DiversityTally] = defaultdict(DiversityTally)

    def add(
        self,
        batch: GraspBatch,
        verdicts: Mapping[str, Mapping[str, np.ndarray]] | None = None,
        *,
        run: str = "",
        grasps: int | None = None,
    ) -> None:
        """Count rows of whole scenes.

        Args:
            batch: Synth columns, and in `header.counts` the attempts of all scenes that the rows
                stand for, those without rows included.
            verdicts: Verdict columns per test of one protocol, row by row; a missing test was not
                run on these rows.
            run: Tells equal scenes of different runs apart.
            grasps: N of the run; None for imported rows, which have no unselected rate.
        """
        verdicts = verdicts or {}
        selected, audit = _flags(batch)
        touched, new = self._note_scenes(batch, run)
        self._kept_of.update(np.unique(batch["scene_id"][selected]).tolist())
        self._add_diversity(batch, selected, audit, {s.size_mm for s in touched.values()})
        run_tests = [test for test in self.tests if test in verdicts]
        passed = {test: _passed(batch, verdicts[test]) for test in run_tests}
        flags = {"selected": selected, "audit": audit}
        arms = arm_trials(batch, verdicts, passed)
        trials = {**passed, **arms.passed}
        self._trials.add(batch, flags, trials, touched, new, grasps, arms.among)
        self._rows["stored"] += len(batch)
        self._rows["selected"] += _number(selected)
        self._rows["audit"] += _number(audit)
        self._attempts.add(batch, selected)
        for test in run_tests:
            self._verdicts[test].update(_labels(verdicts[test]["verdict_status"]))
            self._chosen_verdicts[test].update(_labels(verdicts[test]["verdict_status"][selected]))
            chosen = batch["scene_id"][selected]
            winners = set(chosen[passed[test][selected]].tolist())
            for scene in np.unique(chosen).tolist():
                self._won[test][scene_parts(scene).object_id][scene] |= scene in winners
            self._groups[test].add(
                *(batch["object_id"], batch["size_mm"], batch["setting"]),
                *(hands_label(batch.header), passed[test], verdicts[test], selected),
            )

    def figures(self) -> dict[str, Any]:
        """Plain data for cards, manifests and `--json`; keys are documented in docs/conventions.md."""
        places = self._trials.places
        sizes = sorted({place.size_mm for place in places})
        first = self.tests[0]
        metrics = {test: found.metrics() for test, found in self._groups.items()}
        groups = {test: {by: self.groups(test, by) for by in BOUNDED} for test in self.tests}
        measured = next((test for test in self.tests if metrics[test]), first)
        out: dict[str, Any] = {
            "objects": len({scene.object_id for scene in self._scenes.values()}),
            "scenes": len({scene for _, scene in self._scenes}),
            "n": self._rows["stored"],
            "selected_rows": self._rows["selected"],
            "audit_rows": self._rows["audit"],
            **self._attempts.figures(),
            "by_verdict": dict(sorted(self._verdicts[first].items())),
            "kept": self._trials.kept(places),
            **_means(metrics[measured]),
            **self._spread(None),
            "by_size": {},
            "by_setting": {},
            "tests": {},
        }
        for test in self.tests:
            selected = self._trials.rate("selected", test, places)
            unselected = self._trials.rate("unselected", test, places)
            out[f"suc_{test}"] = selected.to_dict()["rate"]
            out["tests"][test] = {
                "selected": selected.to_dict(),
                "unselected": unselected.to_dict(),
                "object_success": self._object_success(test).to_dict(),
                "by_verdict": dict(sorted(self._verdicts[test].items())),
                "metrics": metrics[test],
                "groups": groups[test],
                **arm_rates(self._trials, test, places),
            }
        for size in sizes:
            group = groups[measured]["size"].get(str(size), {})
            here = [place for place in places if place.size_mm == size]
            out["by_size"][str(size)] = {
                **self._trials.rates(self.tests, here),
                **arm_rates_of(self._trials, self.tests, here),
                **self._attempts.figures(size),
                **_means(group.get("metrics", {})),
                **self._spread(size),
            }
        for setting in sorted({place.setting for place in places}):
            group = groups[measured]["setting"].get(setting, {})
            mine = [place for place in places if place.setting == setting]
            out["by_setting"][setting] = {
                "scenes": len({n for (_, n), s in self._scenes.items() if s.setting == setting}),
                **self._trials.rows(mine),
                **self._trials.rates(self.tests, mine),
                **_means(group.get("metrics", {})),
                "by_size": {
                    str(place.size_mm): self._trials.rates(self.tests, [place]) for place in mine
                },
            }
        return out

    def selected_verdicts(self, test: str) -> dict[str, int]:
        """Selected rows per verdict of a test; `by_verdict` counts all stored rows."""
        return dict(sorted(self._chosen_verdicts[test].items()))

    def without_grasp(self) -> list[str]:
        """Scenes that no grasp was kept of, sorted."""
        return sorted({scene for _, scene in self._scenes} - self._kept_of)

    def groups(self, test: str, by: str) -> dict[str, Any]:
        """Figures of every group of the rows of a test; see `GroupTally.groups`."""
        return self._groups[test].groups(by)

    def _add_diversity(
        self,
        batch: GraspBatch,
        selected: np.ndarray,
        audit: np.ndarray,
        sizes: Collection[int],
    ) -> None:
        found = finite_vectors(batch)
        if found is None:
            return
        of_row = batch["size_mm"][found.rows]
        for tallies, chosen in ((self._diversity, selected), (self._audit_diversity, audit)):
            mine = chosen[found.rows]
            tallies[None].add_vectors(found.vectors[mine])
            for size in sorted(sizes):
                tallies[size].add_vectors(found.vectors[mine & (of_row == size)])

    def _note_scenes(self, batch: GraspBatch, run: str) -> tuple[dict[str, SceneParts], set[str]]:
        """The scenes of a batch, and which of them this run had not touched before."""
        names = {*batch.header.counts, *np.unique(batch["scene_id"]).tolist()}
        touched = {scene: scene_parts(scene) for scene in sorted(names)}
        new = {scene for scene in touched if (run, scene) not in self._scenes}
        self._scenes.update(((run, scene), touched[scene]) for scene in new)
        return touched, new

    def _spread(self, size: int | None) -> dict[str, float | None]:
        found = self._diversity[size].value()
        of_audit = self._audit_diversity[size].value()
        named = {"d": found.d, "d_scale_free": found.scale_free, "d_audit": of_audit.d}
        # The order in which batches come changes the last digits of sums, and must not show.
        return {k: round(float(v), 6) if np.isfinite(v) else None for k, v in named.items()}

    def _object_success(self, test: str) -> Rate:
        won = [self._won[test][obj].values() for obj in sorted(self._won[test])]
        return clustered_interval([sum(scenes) for scenes in won], [len(scenes) for scenes in won])


def rows_text(figures: Mapping[str, Any]) -> str:
    """How many rows are stored and what they are, for a person.

    >>> rows_text({"n": 21, "selected_rows": 12, "audit_rows": 12})
    '21 rows stored (12 selected rows, 12 audit rows, 3 both)'
    """
    n, selected, audit = (figures[k] for k in ("n", "selected_rows", "audit_rows"))
    both = selected + audit - n
    kinds = [counted(selected, "selected row"), counted(audit, "audit row")]
    kinds += [f"{both} both"] if both > 0 else []
    return f"{counted(n, 'row')} stored ({', '.join(kinds)})"


def size_text(size_mm: int | str) -> str:
    """A size in metres for a person, to the millimetre where it is not a whole centimetre."""
    mm = int(size_mm)
    return f"{mm / 1000:.{2 if mm % 10 == 0 else 3}f} m"


def _flags(batch: GraspBatch) -> tuple[np.ndarray, np.ndarray]:
    # Imported rows carry neither flag: they are all selected, none is an audit row.
    n = len(batch)
    selected = batch["selected"] if "selected" in batch else np.ones(n, bool)
    audit = batch["audit"] if "audit" in batch else np.zeros(n, bool)
    return selected, audit


def _passed(batch: GraspBatch, verdict: Mapping[str, np.ndarray]) -> np.ndarray:
    return verdict["success"] & (batch["synth_status"] == Status.OK)


def _means(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    return {name: metrics[name]["mean"] if name in metrics else None for name in HEADLINE}


def _number(mask: np.ndarray) -> int:
    return int(np.count_nonzero(mask))


def _labels(statuses: np.ndarray) -> Counter[str]:
    numbers, counts = np.unique(statuses, return_counts=True)
    return Counter({Status(int(s)).label: int(c) for s, c in zip(numbers, counts, strict=True)})
