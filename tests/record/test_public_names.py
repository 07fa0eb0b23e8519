"""The public names: all there, loaded when first used, light until then."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import bidexdata

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", [n for n in dir(bidexdata) if n != "__version__"])
def test_every_public_name_is_defined_where_the_table_says(name):
    value = getattr(bidexdata, name)
    assert value.__module__.startswith("bidexdata.")
    assert value.__doc__


def test_type_checkers_see_the_same_names_at_the_same_places():
    tree = ast.parse(Path(bidexdata.__file__).read_text(encoding="utf-8"))
    (seen,) = [n for n in tree.body if isinstance(n, ast.If)]
    imports = [n for n in seen.body if isinstance(n, ast.ImportFrom)]
    seen_at = {a.asname: n.module for n in imports for a in n.names}
    assert {*seen_at, "__version__"} == set(dir(bidexdata))
    for name, module in seen_at.items():
        assert getattr(import_module(str(module)), str(name)) is getattr(bidexdata, str(name))
    assert all(a.name == a.asname for n in imports for a in n.names)


@pytest.mark.parametrize("name", [n for n in dir(bidexdata) if n[0].isupper()])
def test_no_other_class_has_the_name_of_a_public_one(name):
    files = Path(bidexdata.__file__).parent.rglob("*.py")
    defined = [p for p in files if re.search(rf"^class {name}\b", p.read_text("utf-8"), re.M)]
    assert len(defined) == 1


def test_what_a_stage_needs_is_public_beside_it():
    request = bidexdata.SynthRequest(config=bidexdata.load_preset("default"), grasps=2)
    assert request.sizes_mm[0] == 300
    assert bidexdata.TaskExecution(executor="inline").workers == 0
    assert {"describe", "render"} <= set(dir(bidexdata))


def test_a_name_that_is_not_public_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'grasp'"):
        _ = bidexdata.grasp


def test_completion_shows_the_public_names():
    assert {"BiDexDataset", "Release", "GraspBatch"} <= set(dir(bidexdata))
    assert {"prepare_library", "synth_library", "validate_run", "pack_runs"} <= set(dir(bidexdata))


def test_the_version_is_that_of_the_package_metadata():
    declared = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.M)
    assert declared
    assert bidexdata.__version__ == declared[1]


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import bidexdata", "torch warp mujoco trimesh viser pyarrow scipy h5py yaml"),
        ("import bidexdata.loaders", "torch warp mujoco trimesh viser pyarrow h5py"),
        ("from bidexdata import GraspBatch", "torch warp mujoco trimesh viser pyarrow h5py"),
        ("from bidexdata import Release, verify_release", "torch warp mujoco trimesh viser"),
        ("from bidexdata import BiDexDataset", "torch warp mujoco trimesh viser"),
    ],
)
def test_reading_needs_none_of_what_writing_needs(code, absent):
    check = f"import sys\n{code}\nprint([m for m in '{absent}'.split() if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_names_that_are_imported_late_are_listed_for_completion():
    from bidexdata import loaders

    assert set(loaders._LATE) <= set(dir(loaders))
