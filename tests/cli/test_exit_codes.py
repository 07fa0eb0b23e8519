"""Bad values: 2 for how a thing is written, 3 for what it names, wherever it stands.

The two lists are the table in docs/conventions.md, row by row.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from bidexdata.cli.main import run

SYNTH = ["synth", "{tmp}/library", "--out", "{tmp}/run", "--hand", "capsule"]
PREPARE = ["prepare", "shapes:box", "--out", "{tmp}/library"]
VALIDATE = ["validate", "{tmp}/run"]
PACK = ["pack", "{tmp}/run", "--out", "{tmp}/release", "--name", "n", "--version", "1.0.0"]
RENDER = ["render", "{tmp}", "--out", "{tmp}/sheet.png"]
VIEW = ["view", "{tmp}"]
BENCH = ["bench", "tables", "{tmp}/library", "--out", "{tmp}/tables", "--hand", "capsule"]
DEMO = ["demo", "--out", "{tmp}/demo"]

FILES = {
    "broken.yaml": "regions: [",
    "list.yaml": "- 1",
    "key.yaml": "regions: {anchorz: 100}",
    "word.yaml": "regions: {score: beauty}",
    "range.yaml": "regions: {anchors: 0}",
    "type.yaml": "regions: {anchors: many}",
    "thesis.tex": "x",
}

WRITTEN = [
    # an unknown or missing option or argument
    (["fly"], "fly"),
    ([*SYNTH, "--fast"], "--fast"),
    (["synth", "{tmp}/library"], "--out"),
    (["info"], "PATH"),
    # an option twice: the first would be forgotten
    (
        [*SYNTH, "--sizes", "0.3", "--sizes", "0.5"],
        "--sizes is given twice; see bidexdata synth --help",
    ),
    ([*PACK, "--version=2.0.0"], "--version is given twice"),
    # settings beside the grasp that repeats those of its run
    ([*SYNTH, "--explain", "00", "--seed", "3"], "leave out --hand"),
    # text where a number belongs
    ([*SYNTH, "--grasps", "many"], "--grasps"),
    ([*SYNTH, "--seed", "1.5"], "--seed"),
    ([*SYNTH, "--sizes", "big"], "--sizes 'big'"),
    ([*SYNTH, "--sizes", "0.3,nan"], "--sizes"),
    ([*SYNTH, "--set", "regions.anchors=many"], "error: regions.anchors must be a whole number"),
    ([*SYNTH, "--set", "regions.anchors=1.5"], "error: regions.anchors must be a whole number"),
    ([*SYNTH, "--config", "{tmp}/type.yaml"], "type.yaml: regions.anchors must be a whole number"),
    ([*PREPARE, "--set", "sdf.cells=many"], "error: sdf.cells must be a whole number"),
    # --set without `=`, a list of the wrong length
    ([*SYNTH, "--set", "regions.anchors"], "KEY=VALUE"),
    ([*PREPARE, "--set", "convex"], "KEY=VALUE"),
    ([*PREPARE, "--set", "=3"], "KEY=VALUE"),
    ([*SYNTH, "--set", "regions=3"], "is a group"),
    ([*SYNTH, "--set", "regions.anchors=["], "not valid YAML"),
    ([*SYNTH, "--set", "placement.left_direction=[1, 2]"], "needs 3 values"),
    # I/N, X.Y.Z, a name, FAMILY/COUNT
    ([*PACK[:-1], "1"], "X.Y.Z"),
    ([*PACK[:5], "my grasps", *PACK[6:]], "'my grasps'"),
    ([*SYNTH, "--shard", "4/4"], "--shard '4/4'"),
    ([*VALIDATE, "--shard", "first"], "--shard 'first'"),
    ([*PREPARE, "--shard", "1/1"], "--shard '1/1'"),
    ([*PREPARE, "--seed", "x"], "--seed"),
    (["prepare", "shapes:box/0", "--out", "{tmp}/library"], "FAMILY/COUNT"),
    # a source without what it needs
    (["prepare", "dexgraspnet:", *PREPARE[2:]], "write dexgraspnet:PATH"),
    (["prepare", "bodex:", *PREPARE[2:]], "write bodex:PATH"),
    (["prepare", "objaverse:random=0", *PREPARE[2:]], "whole number from 1"),
    (["prepare", "objaverse:uids=a,lvis=mug", *PREPARE[2:]], "do not go together"),
    # a number outside its range
    ([*SYNTH, "--grasps", "0"], "--grasps"),
    ([*SYNTH, "--grasps", "20000"], "--grasps"),
    ([*SYNTH, "--candidates", "0"], "--candidates"),
    ([*SYNTH, "--sizes", "90"], "--sizes"),
    ([*SYNTH, "--sizes", "0.3,0.5,0.30"], "--sizes: 0.3 is there more than once"),
    ([*SYNTH, "--seed", "-1"], "--seed"),
    ([*SYNTH, "--workers", "-1"], "--workers"),
    ([*SYNTH, "--set", "regions.anchors=0"], "error: regions.anchors must"),
    ([*SYNTH, "--set", "regions.qp.mu=-1"], "error: regions.qp.mu must"),
    ([*SYNTH, "--set", "optimise.adam.beta1=2"], "error: optimise.adam.beta1 must"),
    (
        [*SYNTH, "--set", "placement.left_direction=[0, 0, 0]"],
        "error: placement.left_direction must",
    ),
    ([*SYNTH, "--config", "{tmp}/range.yaml"], "range.yaml: regions.anchors must"),
    ([*PREPARE, "--limit", "0"], "--limit"),
    ([*PREPARE, "--workers", "-1"], "--workers"),
    ([*PREPARE, "--set", "repair.weld=-1"], "error: repair.weld must"),
    ([*PREPARE, "--set", "repair.near=-0.1"], "error: repair.near must be 0 or more"),
    ([*PREPARE, "--set", "limits.cpu_seconds=0"], "error: limits.cpu_seconds must be positive"),
    ([*PREPARE, "--set", "limits.memory_gib=-1"], "error: limits.memory_gib must be positive"),
    ([*PREPARE, "--set", "limits.wall_seconds=.inf"], "error: limits.wall_seconds must be finite"),
    ([*PREPARE, "--set", "limits.cpu_seconds=1e30"], "error: limits.cpu_seconds must be at most"),
    ([*PREPARE, "--set", "sdf.error=.nan"], "error: sdf.error must be finite"),
    ([*PREPARE, "--set", "select.max_aspect=.nan"], "error: select.max_aspect must be finite"),
    ([*PREPARE, "--set", "surface.seed=-1"], "error: surface.seed must be 0 or more"),
    ([*PREPARE, "--seed", "-1"], "--seed"),
    ([*PREPARE, "--set", "rest.seed=-1"], "error: rest.seed must be 0 or more"),
    ([*RENDER, "--count", "0"], "--count"),
    ([*RENDER, "--views", "9"], "--views"),
    ([*VIEW, "--port", "0"], "--port"),
    ([*DEMO, "--grasps", "0"], "--grasps"),
    ([*BENCH, "--limit", "0"], "--limit"),
    ([*BENCH, "--sizes", "90"], "--sizes"),
    # numbers that do not fit together
    ([*SYNTH, "--grasps", "5", "--candidates", "4"], "--candidates"),
    ([*PREPARE, "--set", "repair.loose_weld=1e-9"], "loose_weld"),
]

NAMED = [
    # a path that does not exist, or holds something else
    (SYNTH, "library: no such file or folder"),
    ([*PREPARE[:1], "nowhere.obj", *PREPARE[2:]], "nowhere.obj"),
    ([*PREPARE[:2], "--out", "{tmp}"], "choose another --out"),
    (VALIDATE, "run: no such file or folder"),
    (BENCH, "library: no such file or folder"),
    (PACK, "run: no such file or folder"),
    (RENDER, "neither a library"),
    (VIEW, "neither a library"),
    (["info", "{tmp}"], "neither a library"),
    (["info", "{tmp}/nothing"], "nothing: no such file or folder"),
    (["verify", "{tmp}"], "is no release (manifest.json is missing)"),
    ([*SYNTH, "--config", "{tmp}/no.yaml"], "no.yaml: no such file"),
    # a source that holds no object of its kind
    (["prepare", "{tmp}", *PREPARE[2:]], "mesh files in it"),
    (["prepare", "dexgraspnet:{tmp}", *PREPARE[2:]], "no object is in it"),
    (["prepare", "bodex:{tmp}/nowhere", *PREPARE[2:]], "nowhere: no such file or folder"),
    (["prepare", "objaverse:uids={tmp}/no.txt", *PREPARE[2:]], "no.txt: no such file"),
    # a file that is no YAML mapping
    ([*SYNTH, "--config", "{tmp}/broken.yaml"], "not valid YAML"),
    ([*PREPARE, "--config", "{tmp}/list.yaml"], "expected a mapping"),
    # an output file of an unknown ending (that of `render`: tests/pictures/test_render.py)
    (["table", "{tmp}", "--out", "{tmp}/a.xls"], "is written as one of .csv, .parquet"),
    # a preset, protocol, executor, device or family that is not there
    ([*SYNTH, "--preset", "papre"], "known: default, paper"),
    ([*VALIDATE, "--protocol", "papre-1"], "known: paper-1"),
    ([*SYNTH, "--executor", "magic"], "known: processes, inline, ray"),
    ([*PREPARE, "--executor", "magic"], "known: processes, inline, ray"),
    ([*VALIDATE, "--executor", "magic"], "known: processes, inline, ray"),
    ([*BENCH, "--executor", "magic"], "known: processes, inline, ray"),
    ([*DEMO, "--executor", "magic"], "known: processes, inline, ray"),
    ([*SYNTH, "--device", "cuda:99"], "this machine has: cpu"),
    (["bench", "speed", "--device", "cuda:99"], "this machine has: cpu"),
    ([*RENDER, "--device", "gpu"], "this machine has: cpu"),
    ([*PREPARE[:1], "shapes:boks", *PREPARE[2:]], "known: box"),
    ([*PREPARE[:1], "moon:rocks", *PREPARE[2:]], "known: shapes"),
    # one of a fixed set of words
    ([*SYNTH, "--setting", "water"], "one of floating, tabletop"),
    ([*PACK, "--form", "hdf"], "one of both, parquet, hdf5"),
    ([*PACK, "--licences", "any"], "one of permissive, nc-ok, ids-only"),
    ([*PACK, "--split", "moon"], "one of object, category, size"),
    ([*RENDER, "--only", "beauty"], "known: success, failure"),
    (["info", "{tmp}", "--by", "beauty"], "known: object, size, setting, hand, status"),
    ([*SYNTH, "--set", "regions.score=beauty"], "one of random, force, torque"),
    ([*SYNTH, "--config", "{tmp}/word.yaml"], "one of random, force, torque"),
    # a key that does not exist
    ([*SYNTH, "--set", "regions.anchorz=3"], "did you mean 'anchors'?"),
    ([*SYNTH, "--set", "sizes=0.3"], "it is an option of its own: --sizes"),
    ([*SYNTH, "--set", "rest_poses=2"], "it is an option of its own: --rest-poses"),
    ([*SYNTH, "--config", "{tmp}/key.yaml"], "key.yaml: regions has no key 'anchorz'"),
    ([*PREPARE, "--set", "convex.thresold=1"], "did you mean 'threshold'?"),
]


@pytest.mark.parametrize(
    ("code", "arguments", "says"),
    [(2, *case) for case in WRITTEN] + [(3, *case) for case in NAMED],
    ids=lambda value: " ".join(value[:1] + value[-2:]) if isinstance(value, list) else "",
)
def test_2_is_how_it_is_written_and_3_what_it_names(
    code: int, arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture
):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    before = sorted(tmp_path.iterdir())
    assert run([a.format(tmp=tmp_path) for a in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert says in err
    assert len(err.strip().splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before, "a refused command wrote something"
