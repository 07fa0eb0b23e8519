"""Publish a release to a repository of Hugging Face's hub, verified first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bidexdata.errors import BadValue, MissingExtra, NotUsable
from bidexdata.formats.card_words import holds_shapes
from bidexdata.formats.licences import allows
from bidexdata.formats.manifest import MANIFEST, MANIFEST_HASH, list_files
from bidexdata.formats.release import Release
from bidexdata.formats.verify import Resimulate, verify_release
from bidexdata.runs.pack import LICENCE_HINT
from bidexdata.wording import counted

if TYPE_CHECKING:
    from huggingface_hub import HfApi

KIND = "dataset"


class Upload(NamedTuple):
    """One file of an upload."""

    name: str
    bytes: int


@dataclass(frozen=True, slots=True)
class PublishReport:
    """What was, or with a dry run would be, uploaded."""

    path: Path
    repo: str
    dry_run: bool
    files: tuple[Upload, ...]
    commit: str = ""
    """Address of the commit; empty for a dry run."""

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(f.bytes for f in self.files)


def publish_release(
    path: str | Path,
    repo: str,
    *,
    dry_run: bool = False,
    private: bool = False,
    full: bool = False,
    resimulate: Resimulate | None = None,
    hub: Callable[[], HfApi] | None = None,
) -> PublishReport:
    """Upload a release as one commit; files of an earlier one that it lacks are deleted there.

    The release is verified first, every file hashed; nothing of one that contradicts its manifest
    is uploaded. Who one is on the hub, `huggingface_hub` knows (`hf auth login`).

    Args:
        path: The release.
        repo: `OWNER/NAME`; made where it does not exist.
        dry_run: Verify and list, upload nothing, ask the hub nothing.
        private: A new repository is private.
        full: Verify as `verify --full` does.
        resimulate: For `full`; see `verify_release`.
        hub: Makes the client, for tests.

    Raises:
        PathNotFound: There is no release at `path`.
        Contradiction: The release contradicts its manifest.
        BadValue: `repo` is not OWNER/NAME.
        NotUsable: A mesh has no licence that allows to give it on, or the hub refuses or cannot be reached.
        MissingExtra: `huggingface_hub` is not installed.
    """
    _check_name(repo)
    release = Release.open(path)
    verify_release(path, full=full, resimulate=resimulate).raise_if_bad()
    _refuse_unlicensed(release)
    names = [*sorted(list_files(release.path)), MANIFEST, MANIFEST_HASH]
    files = tuple(Upload(n, (release.path / n).stat().st_size) for n in names)
    if dry_run:
        return PublishReport(release.path, repo, True, files)
    api = (hub or _hub)()
    commit = _upload(api, release, repo, private)
    return PublishReport(release.path, repo, False, files, commit)


def _upload(api: Any, release: Release, repo: str, private: bool) -> str:
    try:
        api.create_repo(repo_id=repo, repo_type=KIND, private=private, exist_ok=True)
        done = api.upload_folder(
            repo_id=repo,
            repo_type=KIND,
            folder_path=str(release.path),
            commit_message=f"{release.name} {release.version}",
            # What an earlier release had and this one has not would contradict the manifest.
            delete_patterns=["*"],
        )
    except _refusals() as err:
        lines = str(err).strip().splitlines()
        said = lines[0] if lines else type(err).__name__
        raise NotUsable(
            f"{repo} was not published ({said}); log in with `hf auth login`, check the name and "
            "the network, and run the same command again"
        ) from err
    return str(getattr(done, "commit_url", done))


def _refusals() -> tuple[type[BaseException], ...]:
    """Errors of the client, and those of the HTTP library under it, which differs by version."""
    try:
        from huggingface_hub.errors import HfHubHTTPError
    except ImportError:
        return (OSError, ValueError, RuntimeError)
    return (OSError, ValueError, RuntimeError, *HfHubHTTPError.__bases__)


def _check_name(repo: str) -> None:
    owner, slash, name = repo.partition("/")
    if not (slash and owner and name) or "/" in name:
        raise BadValue(f"--repo {repo!r} cannot be used; write OWNER/NAME")


def _refuse_unlicensed(release: Release) -> None:
    if not holds_shapes(release.manifest):
        return
    columns = (release.objects.column(n).to_pylist() for n in ("object_id", "licence"))
    found = [(i, x) for i, x in zip(*columns, strict=True) if not allows(x, "nc-ok")]
    if found:
        raise NotUsable(
            f"{release.path} holds {counted(len(found), 'mesh', 'meshes')} that no known licence "
            f"allows to give on (first: {found[0][0]}, {found[0][1]}); {LICENCE_HINT}"
        )


def _hub() -> HfApi:
    try:
        from huggingface_hub import HfApi
    except ImportError as err:
        raise MissingExtra("huggingface_hub", "publish") from err
    return HfApi(library_name="bidexdata")
