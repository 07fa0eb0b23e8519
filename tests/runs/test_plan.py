"""Laws of the plan: every scene once per round, the same plan everywhere, parts that add up."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from bidexdata.errors import Contradiction
from bidexdata.runs.plan import (
    MOST_TASKS,
    Round,
    plan_tasks,
    read_plan,
    scene_ids_of,
    take_shard,
    write_plan,
)

SIZES = tuple(range(300, 801, 50))


def scenes(objects: int, sizes=SIZES) -> dict[str, list[str]]:
    return {
        f"o{k}-{k:08x}": scene_ids_of(f"o{k}-{k:08x}", sizes, "floating") for k in range(objects)
    }


@pytest.mark.parametrize("candidates", [1, 8, 40, 400, 10_000])
@pytest.mark.parametrize("objects", [0, 1, 7])
def test_every_scene_is_in_one_task_of_every_round(objects: int, candidates: int):
    rounds = (Round(2, candidates), Round(3, 2 * candidates, candidates))
    tasks = plan_tasks(scenes(objects), rounds)
    seen = Counter((t.round, s) for t in tasks for s in t.scene_ids)
    wanted = {(r, s) for r in range(2) for ids in scenes(objects).values() for s in ids}
    assert seen == Counter(wanted)
    assert all({s.split("/")[0] for s in t.scene_ids} == {t.object_id} for t in tasks)
    assert len({t.task_id for t in tasks}) == len(tasks)


def test_chunks_of_an_object_differ_by_at_most_one_scene():
    tasks = plan_tasks(scenes(1), [Round(10, 75)])
    lengths = [len(t.scene_ids) for t in tasks]
    assert len(lengths) > 1
    assert max(lengths) - min(lengths) <= 1


def test_a_large_run_has_about_ten_thousand_tasks():
    assert len(plan_tasks(scenes(3000), [Round(100, 10_000)])) <= 1.5 * MOST_TASKS


def test_growing_keeps_the_tasks_of_earlier_rounds():
    first = plan_tasks(scenes(3), [Round(10, 40)])
    grown = plan_tasks(scenes(3), [Round(10, 40), Round(5, 20, 40)])
    assert grown[: len(first)] == first
    assert {t.task_id for t in grown[len(first) :]}.isdisjoint(t.task_id for t in first)


@pytest.mark.parametrize("n", [1, 2, 5, 100])
def test_the_parts_of_the_machines_are_the_plan(n: int):
    tasks = plan_tasks(scenes(5), [Round(10, 40)])
    parts = [take_shard(tasks, (i, n)) for i in range(n)]
    assert sorted(t.task_id for part in parts for t in part) == sorted(t.task_id for t in tasks)
    assert take_shard(tasks, None) == tasks


def test_a_plan_reads_back_and_has_the_same_bytes_twice(tmp_path: Path):
    tasks = plan_tasks(scenes(3), [Round(10, 40)])
    for name in ("a", "b"):
        write_plan(tmp_path / name, tasks)
    assert read_plan(tmp_path / "a") == tasks
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_table_gives_one_scene_per_size_and_rest_pose():
    assert scene_ids_of("o-1", [300, 500], "tabletop", 2) == [
        "o-1/300/table0",
        "o-1/300/table1",
        "o-1/500/table0",
        "o-1/500/table1",
    ]


@pytest.mark.parametrize("kept", [0, 10, 200, -8])
def test_a_damaged_plan_is_named_and_the_sentence_says_what_to_do(tmp_path: Path, kept: int):
    path = tmp_path / "tasks.parquet"
    write_plan(path, plan_tasks(scenes(3), [Round(10, 40)]))
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(Contradiction, match=r"tasks\.parquet: damaged plan .* delete it"):
        read_plan(path)


def test_a_plan_without_its_columns_is_damaged_too(tmp_path: Path):
    import pyarrow as pa
    from pyarrow import parquet

    path = tmp_path / "tasks.parquet"
    parquet.write_table(pa.table({"task_id": ["a"]}), path)
    with pytest.raises(Contradiction, match="damaged plan"):
        read_plan(path)
