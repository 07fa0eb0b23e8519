"""PrepareReport: what became of the inputs of one call of `prepare`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bidexdata.objects.library import failures_of, left_out_of, warnings_of
from bidexdata.record.status import Status
from bidexdata.runs.prepare_parts import Row


@dataclass(frozen=True, slots=True)
class PrepareReport:
    """What became of the inputs."""

    library: Path
    rows: tuple[Row, ...]
    """One per input, in order (the rows of the index); for a dry run only names and ids.

    Of a part that does not finish the library, only its own."""
    resumed: int
    """Objects of this part that were complete before."""
    seconds: float
    """Wall-clock time."""
    fingerprint: str
    """Of the library; empty while it has no index."""
    made: int = 0
    """Inputs that this call worked on."""
    waiting: int = 0
    """Inputs of other parts that nobody has settled yet; the index is written when none is left."""
    no_longer: tuple[str, ...] = ()
    """Objects that the index listed before and that these inputs do not name; their files stay."""

    @property
    def by_status(self) -> dict[str, int]:
        """Number of inputs per status label."""
        return dict(sorted(Counter(Status(r["status"]).label for r in self.rows).items()))

    @property
    def prepared(self) -> int:
        """Number of prepared objects."""
        return sum(r["status"] == Status.OK for r in self.rows)

    @property
    def hulls(self) -> int:
        """Number of prepared objects that had to be replaced by their hull."""
        return sum(r.get("piece_method") == "hull" for r in self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Figures for `--json`."""
        return {
            "library": str(self.library),
            "inputs": len(self.rows),
            "prepared": self.prepared,
            "hulls": self.hulls,
            "resumed": self.resumed,
            "made": self.made,
            "no_longer": list(self.no_longer),
            "by_status": self.by_status,
            "failures": failures_of(self.rows),
            "left_out": left_out_of(self.rows),
            "warnings": warnings_of(self.rows),
            "waiting": self.waiting,
            "seconds": round(self.seconds, 3),
            "fingerprint": self.fingerprint,
        }
