"""A virtual environment with the wheel and what it requires, nothing else, reads a release."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from made_release import made_release

from bidexdata.hands import load_hands

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("torch", "mujoco", "warp", "trimesh", "scipy", "viser", "ray", "PIL")

READ = """
import sys
from importlib.util import find_spec
import bidexdata
assert "site-packages" in bidexdata.__file__, bidexdata.__file__
assert not [name for name in sys.argv[2:] if find_spec(name)]
from bidexdata import Release
from bidexdata.errors import MissingExtra
release = Release.open(sys.argv[1])
rows = release.grasps()
solid = release.load_solid(release.object_ids[0])
print(len(rows), rows["hand_pos"].shape[1:], len(solid.pieces), release.cloud().shape[1:])
for use in ("BiDexDataset", "HandModel"):
    try:
        getattr(bidexdata, use)(sys.argv[1])
    except MissingExtra as err:
        print(use, err)
"""


def run(*command, cwd: Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    plain = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [str(c) for c in command], cwd=cwd, env=plain, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 or not check, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    """Folder of the programs of an environment with the core alone."""
    folder = tmp_path_factory.mktemp("clean")
    found = run(
        sys.executable, *("-m", "pip", "download", "-q", "--no-deps", "--dest"), folder / "probe",
        "typer", cwd=folder, check=False,
    )  # fmt: skip
    if found.returncode:
        pytest.skip("needs a package index, and none is reachable")
    run(
        sys.executable, *("-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir"), folder / "wheel",
        ROOT, cwd=folder,
    )  # fmt: skip
    (wheel,) = (folder / "wheel").glob("bidexdata-*.whl")
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    run(folder / "venv" / "bin" / "python", "-m", "pip", "install", "-q", wheel, cwd=folder)
    return folder / "venv" / "bin"


def test_the_core_alone_reads_a_release_and_names_what_it_lacks(clean, packed, tmp_path):
    read, *lacking = run(
        clean / "python", "-c", READ, packed, *HEAVY, cwd=tmp_path
    ).stdout.splitlines()
    assert read == "24 (2, 3, 3) 1 (1024, 3)"
    assert len(lacking) == 2
    assert lacking[0].startswith("BiDexDataset this needs the package 'torch'")
    assert lacking[0].endswith("pip install torch")
    assert lacking[1].endswith("pip install 'bidexdata[synth]'")


def test_its_commands_read_a_release_and_name_their_extra(clean, tmp_path):
    packed = made_release(tmp_path / "release", hands=load_hands("capsule"))
    command = clean / "bidexdata"
    assert "made 1.0.0" in run(command, "info", packed, cwd=tmp_path).stdout
    assert "ok" in run(command, "verify", packed, cwd=tmp_path).stdout
    run(command, "table", packed, "--out", "rows.csv", cwd=tmp_path)
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 1 + 42
    for arguments, extra in (
        (("view", packed), "view"),
        (("prepare", "shapes", "--out", "library"), "synth"),
        (("verify", packed, "--full"), "synth"),
        (("render", packed, "--out", "sheet.png"), "synth"),
        (("demo", "--out", "demo"), "synth"),
    ):
        done = run(command, *arguments, cwd=tmp_path, check=False)
        assert done.returncode == 3, done.stderr
        assert done.stderr.strip().endswith(f"pip install 'bidexdata[{extra}]'")
