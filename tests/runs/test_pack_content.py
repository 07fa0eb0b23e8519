"""Packing a run: where objects are written and how rows came about shows in no byte."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from made_dexgraspbench import made_dexgraspbench
from made_release import made_verdicts

from bidexdata.formats.release import Release
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.runs import import_objects, pack_objects
from bidexdata.runs.content_hash import run_content_hash
from bidexdata.runs.import_ import ImportRequest, import_run
from bidexdata.runs.pack import pack_runs
from bidexdata.runs.run import Run, verdict_fingerprint
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import shard_path, write_shard
from bidexdata.runs.stage import TaskExecution
from bidexdata.validation.protocols import load_protocol


@pytest.fixture(scope="module")
def imported(tmp_path_factory) -> Path:
    """An imported run without verdicts; read only."""
    root = tmp_path_factory.mktemp("content")
    small = PrepareConfig(surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12))
    asked = ImportRequest(
        format="dexgraspbench", path=made_dexgraspbench(root / "bench"), hand="capsule"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_objects, "PrepareConfig", lambda: small)
        import_run(asked, root / "run", execution=TaskExecution(executor="inline", quiet=True))
    return root / "run"


@pytest.fixture(autouse=True)
def licensed(monkeypatch):
    """The made objects state no licence; here their meshes may be given away."""
    monkeypatch.setattr("bidexdata.formats.licences.normal_licence", lambda text: "MIT")


def tree_bytes(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def test_the_content_hash_of_a_run_is_of_its_rows_and_verdicts(imported, tmp_path):
    whole = run_content_hash(Run.open(imported))
    run = Run.open(shutil.copytree(imported, tmp_path / "run"))
    assert run_content_hash(run) == whole
    task = run.tasks[-1]
    path = shard_path(run.stage_folder("rows"), task.task_id)
    batch = run.task_batch(task)
    write_shard(path, batch.to_arrow(), run.fingerprint, notes={"made": "elsewhere"})
    assert run_content_hash(run) == whole  # what made a shard is not its content
    protocol = load_protocol("paper-1")
    verdicts = made_verdicts(batch, np.random.default_rng(0))
    table = verdict_batch(batch.header, batch["grasp_id"], verdicts).to_arrow()
    judged = shard_path(run.stage_folder("validate", "paper-1", "f"), task.task_id)
    write_shard(judged, table, verdict_fingerprint(run, protocol, "f"))
    tested = run_content_hash(run)
    assert tested != whole
    path.unlink()
    assert run_content_hash(run) not in (whole, tested)


@pytest.mark.slow
def test_processes_write_the_objects_that_one_writes(imported, tmp_path, monkeypatch):
    options = {"name": "made", "version": "1.0.0", "quiet": True}
    pack_runs([imported], tmp_path / "here", **options)
    monkeypatch.setattr(pack_objects, "FEW", 0)
    monkeypatch.setattr(pack_objects, "CHUNK", 1)
    pack_runs([imported], tmp_path / "there", **options)
    assert tree_bytes(tmp_path / "here") == tree_bytes(tmp_path / "there")


def test_what_is_wrong_with_an_object_is_said_by_its_own_error(imported, tmp_path, monkeypatch):
    from bidexdata.errors import Contradiction

    shutil.copytree(imported, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    (run.library.folder(run.object_ids[0]) / "mesh.glb").write_bytes(b"")
    with pytest.raises(Contradiction, match="its sha256 differs"):
        pack_runs([run.path], tmp_path / "release", name="made", version="1.0.0", quiet=True)
    assert not (tmp_path / "release").exists()


def test_the_rows_of_a_run_can_be_packed_into_the_training_form_alone(imported, tmp_path):
    options = {"name": "made", "version": "1.0.0", "quiet": True}
    alone = pack_runs([imported], tmp_path / "alone", form="hdf5", **options).path
    both = pack_runs([imported], tmp_path / "both", **options).path
    one, two = (Release.open(path).manifest["content_hash"] for path in (alone, both))
    assert one == two
