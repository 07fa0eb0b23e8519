"""Other people's readers read a release: in environments of their own, without this package."""

import json
import os
import subprocess
from pathlib import Path

import pytest
from made_release import OBJECTS, PER_SCENE, SIZES, made_release

from bidexdata.formats.release import Release

pytestmark = pytest.mark.slow
N = len(OBJECTS) * len(SIZES) * PER_SCENE


def said(python: Path, code: str, *arguments: object, home: Path) -> dict:
    """Run code that prints one JSON object as its last line."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment |= {"HF_HUB_OFFLINE": "1", "HF_HOME": str(home), "HOME": str(home)}
    done = subprocess.run(
        [str(python), "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=home,
        env=environment,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.strip().splitlines()[-1])


def rows_of(release: Path) -> dict[str, list]:
    batch = Release.open(release).grasps()
    return {
        "ids": batch["grasp_id"].tolist(),
        "first": [float(v) for v in batch["hand_pos"][0].reshape(-1)],
        "success": int(batch["success"].sum()),
    }


HUB = """
import json, sys
from datasets import load_dataset, get_dataset_config_names
where = sys.argv[1]
names = get_dataset_config_names(where)
found = load_dataset(where)
rows = [r for split in found for r in found[split]]
others = {n: sum(len(part) for part in load_dataset(where, n).values()) for n in names}
print(json.dumps({
    "names": names, "splits": list(found), "ids": [r["grasp_id"] for r in rows],
    "first": rows[0]["hand_pos"], "success": sum(bool(r["suc_f"]) for r in rows), "others": others,
}))
"""


def test_load_dataset_reads_every_configuration_of_the_local_folder(readers, published, tmp_path):
    found = said(readers, HUB, published, home=tmp_path)
    ours = rows_of(published)
    assert found["splits"] == ["train", "test"]
    assert {key: found[key] for key in ours} == ours
    assert found["names"][0] == "selected"
    assert found["others"] == {
        "selected": N,
        "audit": N,
        "contacts": N,
        "contacts_audit": N,
        "verdicts-paper-1-f": N,
        "verdicts_audit-paper-1-f": N,
        "objects": len(OBJECTS),
        "scenes": len(OBJECTS) * len(SIZES),
        "runs": 1,
    }


TABLES = """
import json, sys
import duckdb, pandas, polars
where = sys.argv[1]
files = [f"{where}/grasps/{s}-*.parquet" for s in ("train", "test")]
found = {}
con = duckdb.connect()
rows = [r for f in files for r in con.execute(
    "select grasp_id, hand_pos, suc_f from read_parquet(?)", [f]).fetchall()]
found["duckdb"] = rows
frames = [polars.read_parquet(f) for f in files]
found["polars"] = [r for f in frames for r in f.select("grasp_id", "hand_pos", "suc_f").rows()]
frames = [pandas.read_parquet(f"{where}/grasps/{s}-00000.parquet") for s in ("train", "test")]
found["pandas"] = [
    (r.grasp_id, r.hand_pos.tolist(), bool(r.suc_f)) for f in frames for r in f.itertuples()]
print(json.dumps({k: {"ids": [r[0] for r in v], "first": list(v[0][1]),
    "success": sum(bool(r[2]) for r in v)} for k, v in found.items()}))
"""


def test_duckdb_polars_and_pandas_read_the_same_rows(readers, published, tmp_path):
    ours = rows_of(published)
    found = said(readers, TABLES, published, home=tmp_path)
    assert set(found) == {"duckdb", "polars", "pandas"}
    for reader, rows in found.items():
        assert rows == ours, reader


CROISSANT = """
import json, sys
import mlcroissant
data = mlcroissant.Dataset(jsonld=sys.argv[1] + "/croissant.json")
assert not data.metadata.ctx.issues.errors, data.metadata.ctx.issues.errors
counts, splits = {}, set()
for record_set in data.metadata.record_sets:
    rows = list(data.records(record_set.id))
    counts[record_set.id] = len(rows)
    if record_set.id == "selected":
        ids = sorted(r["selected/grasp_id"].decode() for r in rows)
        splits = sorted({r["selected/split"].decode() for r in rows})
        width = len(rows[0]["selected/joints"])
print(json.dumps({"counts": counts, "ids": ids, "splits": splits, "width": width,
    "warnings": sorted(data.metadata.ctx.issues.warnings)}))
"""


def test_mlcroissant_validates_and_loads_every_record_set(readers, published, tmp_path):
    command = [str(readers.parent / "mlcroissant"), "validate", "--jsonld", "croissant.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=published)
    assert done.returncode == 0, done.stderr
    assert "Done." in done.stderr
    assert "WARNING" not in done.stderr
    found = said(readers, CROISSANT, published, home=tmp_path)
    assert found["ids"] == sorted(rows_of(published)["ids"])
    assert found["splits"] == ["test", "train"]
    assert found["width"] == 2 * 3 * 3
    assert found["warnings"] == []
    assert found["counts"] == {
        "objects": len(OBJECTS),
        "scenes": len(OBJECTS) * len(SIZES),
        "runs": 1,
        "selected": N,
        "audit": N,
        "contacts": N,
        "contacts_audit": N,
        "verdicts-paper-1-f": N,
        "verdicts_audit-paper-1-f": N,
    }


DAMAGED = """
import json, sys
import mlcroissant
data = mlcroissant.Dataset(jsonld=sys.argv[1] + "/croissant.json")
try:
    list(data.records("objects"))
    print(json.dumps({"error": ""}))
except Exception as err:
    print(json.dumps({"error": str(err)}))
"""


def test_mlcroissant_finds_a_table_that_is_not_the_stated_one(readers, tmp_path):
    out = made_release(tmp_path / "release", OBJECTS[:1])
    whole = out / "objects.parquet"
    assert said(readers, DAMAGED, out, home=tmp_path)["error"] == ""
    whole.write_bytes(whole.read_bytes() + b"\0")
    assert "objects.parquet" in said(readers, DAMAGED, out, home=tmp_path)["error"]


def test_the_citation_validates(cff, published, tmp_path):
    bare = made_release(tmp_path / "bare", OBJECTS[:1])
    for release in (published, bare):
        command = [str(cff.parent / "cffconvert"), "--validate", "-i", "CITATION.cff"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=release)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "valid" in done.stdout


PARAMETERS = """
import inspect, json
from huggingface_hub import HfApi
print(json.dumps({n: list(inspect.signature(getattr(HfApi, n)).parameters)
    for n in ("create_repo", "upload_folder")}))
"""


def test_the_hub_s_client_takes_what_publish_gives_it(readers, tmp_path):
    found = said(readers, PARAMETERS, home=tmp_path)
    assert {"repo_id", "repo_type", "private", "exist_ok"} <= set(found["create_repo"])
    wanted = {"repo_id", "repo_type", "folder_path", "commit_message", "delete_patterns"}
    assert wanted <= set(found["upload_folder"])
