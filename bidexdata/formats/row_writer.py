"""Writers of all row tables of a release, each in a thread of its own, that stay aligned.

Whatever is written is hashed (content hash) and, of selected rows, summed (statistics) on the way,
so that no file is read again for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.formats import parquet, tables
from bidexdata.formats.background import Background
from bidexdata.formats.content_hash import ContentTally, row_table_names
from bidexdata.formats.rows import (
    ObjectRows,
    TestKey,
    arms_table,
    contacts_table,
    grasps_table,
    verdicts_table,
)
from bidexdata.formats.statistics import CONFIGURATION, StatisticsTally
from bidexdata.formats.tables import CONFIGURATIONS, SORTED_BY
from bidexdata.record import Header

if TYPE_CHECKING:
    import pyarrow as pa

Place = tuple[str, str, str]
"""Configuration, split and table."""


class RowWriters:
    """Writes rows object by object; `close` or, after an exception, `stop` must be called.

    State: a Parquet writer and a thread per table, configuration and split; running hashes and sums.
    """

    def __init__(
        self,
        root: Path,
        header: Header,
        tests: Sequence[TestKey],
        splits: Sequence[str],
        content: ContentTally,
    ):
        self.statistics = {name: StatisticsTally() for name in splits}
        """Of the selected rows of every split."""
        self._root, self._tests, self._content = root, tuple(tests), content
        self._arms = tables.arms_tables(header)
        self._threads: dict[Place, Background] = {}
        self._writers: dict[Place, parquet.TableWriter] = {}
        for configuration in CONFIGURATIONS:
            for split in splits:
                for table in row_table_names(header, tests):
                    self._add_writer((configuration, split, table), header)

    @property
    def file_rows(self) -> dict[str, int]:
        """Rows of every file, by its name in the release."""
        files = (item for writer in self._writers.values() for item in writer.files.items())
        return {path.relative_to(self._root).as_posix(): rows for path, rows in files}

    def add(self, rows: ObjectRows, split: str, protocol: str) -> None:
        """Append rows of one object to one split.

        Args:
            rows: Sorted.
            split: Where they go.
            protocol: Whose verdicts are `suc_*` and the metrics.
        """
        for configuration in CONFIGURATIONS:
            mine = rows.select(rows.batch[configuration])
            made = {"grasps": grasps_table(mine, protocol), "contacts": contacts_table(mine)}
            made |= {name: arms_table(mine) for name in self._arms}
            made |= {f"verdicts/{p}-{t}": verdicts_table(mine, (p, t)) for p, t in self._tests}
            for table, part in made.items():
                self._writers[configuration, split, table].add_object(part)

    def close(self) -> None:
        """Write what is waiting and wait for it."""
        for writer in self._writers.values():
            writer.close()
        for thread in self._threads.values():
            thread.close()

    def stop(self) -> None:
        """End all threads."""
        for thread in self._threads.values():
            thread.stop()

    def _add_writer(self, place: Place, header: Header) -> None:
        configuration, split, table = place
        schema = tables.row_schema(table, header)
        watch = self._watcher(place)
        watch(schema.empty_table())
        self._threads[place] = Background()
        self._writers[place] = parquet.TableWriter(
            self._root / tables.folder_of(table, configuration),
            split,
            schema,
            SORTED_BY if table == "grasps" else (),
            watch=watch,
            do=self._threads[place].do,
        )

    def _watcher(self, place: Place) -> Callable[[pa.Table], None]:
        configuration, split, table = place
        name = "/".join(place)
        summed = configuration == CONFIGURATION and table in ("grasps", "contacts")
        tally = self.statistics[split] if summed else None

        def watch(rows: pa.Table) -> None:
            self._content.add(name, rows)
            if tally is not None:
                tally.add(rows)

        return watch
