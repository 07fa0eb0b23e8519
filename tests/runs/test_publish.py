"""What is uploaded is the release, whole and verified, or nothing."""

from __future__ import annotations

import json
import shutil
import sys
from fnmatch import fnmatch
from pathlib import Path
from types import SimpleNamespace

import pytest
from made_release import OBJECTS, made_release

from bidexdata.cli.main import run
from bidexdata.errors import BadValue, Contradiction, MissingExtra, NotUsable, PathNotFound
from bidexdata.formats.verify import verify_release
from bidexdata.runs.publish import publish_release


class FolderHub:
    """A hub that keeps its repositories in a folder and does what the real one does with files."""

    def __init__(self, root: Path):
        self.root = root
        self.calls: list[str] = []

    def create_repo(self, *, repo_id: str, repo_type: str, private: bool, exist_ok: bool) -> None:
        assert (repo_type, exist_ok) == ("dataset", True)
        self.calls.append(f"create {repo_id}{' private' * private}")
        (self.root / repo_id).mkdir(parents=True, exist_ok=True)
        (self.root / repo_id / ".gitattributes").touch()

    def upload_folder(
        self,
        *,
        repo_id: str,
        repo_type: str,
        folder_path: str,
        commit_message: str,
        delete_patterns: list[str],
    ) -> SimpleNamespace:
        assert repo_type == "dataset"
        self.calls.append(f"upload {repo_id}: {commit_message}")
        there = self.root / repo_id
        for path in [p for p in there.rglob("*") if p.is_file()]:
            name = path.relative_to(there).as_posix()
            if name != ".gitattributes" and any(fnmatch(name, p) for p in delete_patterns):
                path.unlink()
        shutil.copytree(folder_path, there, dirs_exist_ok=True)
        return SimpleNamespace(commit_url=f"https://hub.example/{repo_id}/commit/1")


@pytest.fixture(scope="module")
def release(tmp_path_factory) -> Path:
    """A release whose only object states its licence."""
    return made_release(tmp_path_factory.mktemp("publish") / "release", OBJECTS[:1])


def test_what_arrives_is_the_release_and_verifies(release, tmp_path):
    hub = FolderHub(tmp_path)
    first = publish_release(release, "lab/grasps", hub=lambda: hub, private=True)
    assert hub.calls == ["create lab/grasps private", "upload lab/grasps: made 1.0.0"]
    assert first.commit == "https://hub.example/lab/grasps/commit/1"
    there = tmp_path / "lab" / "grasps"
    assert verify_release(there).ok  # the hub's own .gitattributes is no file of the release
    (there / "grasps" / "old-00000.parquet").touch()
    publish_release(release, "lab/grasps", hub=lambda: hub)
    report = verify_release(there)
    assert report.ok, report.checks
    assert first.bytes == sum(p.stat().st_size for p in release.rglob("*") if p.is_file())
    assert {f.name for f in first.files} == {
        p.relative_to(release).as_posix() for p in release.rglob("*") if p.is_file()
    }


def test_a_dry_run_lists_and_asks_no_hub(release, capsys):
    arguments = ["publish", str(release), "--repo", "lab/grasps", "--dry-run"]
    assert run([*arguments, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["dry_run"] is True
    assert data["commit"] == ""
    assert {f["name"] for f in data["files"]} >= {"manifest.json", "manifest.sha256", "README.md"}
    assert data["bytes"] == sum(f["bytes"] for f in data["files"])
    assert data["next"] == f"bidexdata publish {release} --repo lab/grasps"
    assert run(arguments) == 0
    assert "would upload" in capsys.readouterr().out


def test_the_command_uploads_through_huggingface_hub(release, tmp_path, monkeypatch, capsys):
    hub = FolderHub(tmp_path)
    fake = SimpleNamespace(HfApi=lambda library_name: hub)
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    assert run(["publish", str(release), "--repo", "lab/grasps"]) == 0
    assert "https://hub.example/lab/grasps/commit/1" in capsys.readouterr().out
    assert (tmp_path / "lab" / "grasps" / "manifest.json").is_file()


def test_nothing_of_a_damaged_release_is_uploaded(release, tmp_path):
    bad = Path(shutil.copytree(release, tmp_path / "bad"))
    data = bytearray((bad / "objects.parquet").read_bytes())
    data[len(data) // 2] ^= 1
    (bad / "objects.parquet").write_bytes(data)
    hub = FolderHub(tmp_path)
    with pytest.raises(Contradiction, match=r"objects\.parquet does not match its sha256"):
        publish_release(bad, "lab/grasps", hub=lambda: hub)
    assert hub.calls == []


def test_meshes_of_unknown_licence_are_not_uploaded_and_names_are(tmp_path):
    hub = FolderHub(tmp_path / "hub")
    whole = made_release(tmp_path / "whole")
    with pytest.raises(NotUsable, match=r"2 meshes that no known .*first: flat-bbbbbbbb, unknown"):
        publish_release(whole, "lab/grasps", hub=lambda: hub)
    assert hub.calls == []
    names = made_release(tmp_path / "names", licences="ids-only")
    publish_release(names, "lab/grasps", hub=lambda: hub)
    assert not list((tmp_path / "hub").rglob("*.glb"))


@pytest.mark.parametrize("repo", ["grasps", "a/b/c", "/b", "a/", ""])
def test_a_repository_has_an_owner_and_a_name(release, repo):
    with pytest.raises(BadValue, match="OWNER/NAME"):
        publish_release(release, repo, dry_run=True)


def test_a_hub_that_refuses_is_one_sentence(release, tmp_path):
    class Refusing(FolderHub):
        def create_repo(self, **_):
            raise OSError("401 Client Error\nRepository Not Found")

    with pytest.raises(NotUsable, match=r"not published \(401 Client Error\); log in") as said:
        publish_release(release, "lab/grasps", hub=lambda: Refusing(tmp_path))
    assert "\n" not in str(said.value)
    with pytest.raises(PathNotFound):
        publish_release(tmp_path / "nowhere", "lab/grasps", dry_run=True)


def test_without_the_client_the_extra_is_named(release, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingExtra, match=r"bidexdata\[publish\]"):
        publish_release(release, "lab/grasps")
