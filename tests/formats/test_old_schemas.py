"""A release of every schema that was ever written opens, reads, loads and verifies, for good.

Where they come from: `old_releases`.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from old_releases import ARCHIVES, SCHEMAS, unpacked
from plain_reader import PlainRelease

from bidexdata.errors import Contradiction, NotUsable
from bidexdata.formats import hdf5
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.release import Release
from bidexdata.formats.verify import verify_release
from bidexdata.record.batch import SCHEMA_VERSION

LARGEST = 300_000
"""Bytes of all of them together: whoever clones the project has them too."""


@pytest.fixture(scope="module", params=SCHEMAS)
def old(request, tmp_path_factory) -> Path:
    return unpacked(request.param, tmp_path_factory.mktemp("old"))


def test_there_is_a_fixture_of_every_schema_before_this_one():
    major, minor = map(int, SCHEMA_VERSION.split("."))
    # Schemas 1.0 and 1.1 were written by no version that was given away.
    before = {f"schema-{major}.{m}" for m in range(2, minor)}
    assert before <= set(SCHEMAS)
    assert sum(path.stat().st_size for path in ARCHIVES) < LARGEST


def test_an_old_release_keeps_every_law(old):
    report = verify_release(old, full=True)
    assert report.ok, [c.detail for c in report.checks if not c.ok]


def test_an_old_release_reads_in_both_forms(old):
    release = Release.open(old)
    assert old.name == f"schema-{release.header.schema_version}"
    rows = release.grasps()
    assert len(rows) == release.figures["selected_rows"] == 4
    assert len(release.grasps(configuration="audit")) == release.figures["audit_rows"] == 4
    assert np.isfinite(rows.hand_pos).all()
    assert set(release.objects.column("licence").to_pylist()) == {"CC0-1.0"}
    solid = release.load_solid(release.object_ids[0])
    assert len(solid.pieces) == 1
    assert release.cloud("cloud_solid", solid.object_id).shape == (64, 3)
    mapped = hdf5.map_values(old, "selected", "train")
    assert mapped is not None
    place, shape = mapped.columns["joints"]
    np.testing.assert_array_equal(
        np.asarray(mapped.values[:, place]).reshape(-1, *shape), rows.joints
    )


def test_an_old_release_loads(old):
    pytest.importorskip("torch")
    from bidexdata import BiDexDataset

    data = BiDexDataset(old, split="train", points=32)
    assert len(data) == 4
    assert data[0]["cloud_solid"].shape == (32, 3)


def test_an_old_release_has_no_arms_and_says_so(old):
    from bidexdata.runs.trajectories import export_trajectories

    release = Release.open(old)
    assert release.rig == ""
    assert release.header.arms == ()
    assert PlainRelease(old).arms == []
    with pytest.raises(NotUsable, match="has no arm solutions"):
        release.with_arms(release.grasps())
    with pytest.raises(NotUsable, match="has no arm solutions"):
        export_trajectories(old, old.parent / "out", "csv", quiet=True)
    pytest.importorskip("torch")
    from bidexdata import BiDexDataset

    with pytest.raises(NotUsable, match="has no arm solutions, so no arm_path"):
        BiDexDataset(old, fields=("arm_path",), cloud=None)


def newer(folder: Path, version: str) -> Path:
    """The release in `folder`, said to be of another schema."""
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest.pop("files")
    header = json.loads(manifest["header"])
    manifest["header"] = json.dumps({**header, "schema_version": version})
    write_manifest(folder, {**manifest, "schema_version": version})
    return folder


def test_a_newer_major_version_is_refused_with_the_command_that_upgrades(tmp_path):
    folder = newer(unpacked(SCHEMAS[0], tmp_path), "2.0")
    with pytest.raises(Contradiction, match=r"schema 2\.0.*`pip install -U bidexdata`"):
        Release.open(folder)
    (said,) = verify_release(folder).checks
    assert "pip install -U bidexdata" in said.detail


def test_a_newer_minor_version_opens(tmp_path):
    major = SCHEMA_VERSION.partition(".")[0]
    folder = newer(unpacked(SCHEMAS[0], tmp_path), f"{major}.99")
    assert len(Release.open(folder).grasps()) == 4
