import copy
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from made_release import OBJECTS, made_object, made_release

from bidexdata.cli.figures import figure_lines
from bidexdata.cli.main import run
from bidexdata.cli.report import percent
from bidexdata.formats.card import rate_text
from bidexdata.formats.figures import size_text
from bidexdata.formats.metric_text import metric_text
from bidexdata.formats.release import Release
from bidexdata.formats.verify import verify_release
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record import Status
from bidexdata.record.rates import clustered_interval, rate_interval
from bidexdata.wording import share


def front_matter(readme: str) -> dict:
    return yaml.safe_load(readme.split("---\n")[1])


def rate_of(batch):
    mine = [batch["success"][batch["object_id"] == obj] for obj in np.unique(batch["object_id"])]
    return clustered_interval([int(m.sum()) for m in mine], [len(m) for m in mine])


def test_the_card_states_the_rates_of_the_rows(packed):
    release = Release.open(packed)
    batch = release.grasps()
    expected = rate_of(batch)
    card = (packed / "DATASET_CARD.md").read_text()
    assert f"| Selected SUC-F | {expected}, {expected.method} |" in card
    unselected = rate_of(release.grasps(configuration="audit"))
    assert f"| Unselected SUC-F | {unselected}, {unselected.method} |" in card
    assert f"| {len(batch)} |" in card


def test_card_and_info_state_object_success_and_the_d_of_audit_rows(packed):
    release = Release.open(packed)
    batch, figures = release.grasps(), release.figures
    scenes = np.unique(batch["scene_id"])
    won = np.isin(scenes, batch["scene_id"][batch["success"]])
    stated = figures["tests"]["f"]["object_success"]
    assert (stated["k"], stated["n"]) == (won.sum(), len(scenes))
    card = (packed / "DATASET_CARD.md").read_text()
    assert f"| Object success, test `f` | {rate_text(stated)} |" in card
    assert f"of the audit\nrows: {share(figures['d_audit'])}." in card
    said = "\n".join(figure_lines(figures, "paper-1"))
    assert f"; object success {percent(stated)}" in said
    assert f", audit rows {share(figures['d_audit'])})" in said


def test_figures_of_a_release_packed_before_are_shown_without_what_they_lack(packed):
    figures = copy.deepcopy(Release.open(packed).figures)
    del figures["d_audit"], figures["tests"]["f"]["object_success"]
    said = "\n".join(figure_lines(figures, "paper-1")[:-1])
    assert "object success" not in said
    assert "audit rows)" not in said.split("means over selected")[1]


def test_the_card_states_the_means_of_the_rows_with_their_intervals(packed):
    release = Release.open(packed)
    batch, audit = release.grasps(), release.grasps(configuration="audit")
    audit = audit.select(~audit["selected"])
    card = (packed / "DATASET_CARD.md").read_text()
    stated = release.figures["tests"]["f"]
    for status, found in stated["groups"]["status"].items():
        # Per status the audit rows count too, those that are selected as well only once.
        of_status = (b["verdict_status"] == Status[status.upper()] for b in (batch, audit))
        ours, theirs = (b["pd"][rows] for b, rows in zip((batch, audit), of_status, strict=True))
        depths = np.concatenate([ours, theirs]).astype(float)
        assert f"| `{status}` | {len(depths)} | {1000 * depths.mean():.2f}" in card
        assert found["metrics"]["pd"]["n"] == len(depths)
        assert len(depths) > len(ours)
    mean = metric_text("pd", stated["metrics"]["pd"])
    assert f"| PD mm | {mean} | {len(batch)} | {len(OBJECTS)} | object t |" in card
    for size, found in stated["groups"]["size"].items():
        row = next(line for line in card.splitlines() if line.startswith(f"| {size_text(size)} |"))
        assert metric_text("pd", found["metrics"]["pd"]) in row
    assert not any(object_id in card for object_id in OBJECTS)


def test_an_untested_release_has_a_card_without_means(tmp_path):
    out = made_release(tmp_path / "r", OBJECTS[:1], tested=False)
    assert "Nothing was measured." in (out / "DATASET_CARD.md").read_text()


def test_nothing_is_left_to_fill_in(packed):
    for name in ("DATASET_CARD.md", "README.md"):
        text = (packed / name).read_text()
        assert not re.search(r"\$\{|\bNone\b|\bnan\b|TODO", text)


def test_hub_metadata_lists_splits_that_have_rows(packed, tmp_path):
    data = front_matter((packed / "README.md").read_text())
    configs = {c["config_name"]: c for c in data["configs"]}
    assert configs["selected"]["default"] is True
    for name in ("selected", "audit"):
        for entry in configs[name]["data_files"]:
            assert list(packed.glob(entry["path"])), entry
    assert data["license"] == "other"  # two objects state none
    one = made_release(tmp_path / "one", OBJECTS[:1])
    data = front_matter((one / "README.md").read_text())
    splits = [e["split"] for e in data["configs"][0]["data_files"]]
    assert splits == ["train"]
    assert data["license"] == "cc0-1.0"


def test_what_the_source_does_not_state_is_unknown_and_counts_as_no_author(tmp_path, monkeypatch):
    # As `prepare` stores a bare mesh file (the word), and as a sparse list file may leave it (empty).
    for stored in (UNKNOWN, ""):
        origin = dict.fromkeys(("source", "licence", "author", "category"), stored)

        def unlicensed(object_id, origin=origin):
            obj = made_object(object_id)
            return replace(obj, provenance={**obj.provenance, **origin})

        monkeypatch.setattr("made_release.made_object", unlicensed)
        out = made_release(tmp_path / f"r{stored}", OBJECTS[:1])
        card = (out / "DATASET_CARD.md").read_text()
        assert "| licence | source | objects | named authors |" in card
        assert "| unknown | unknown | 1 | 0 |" in card
        assert "The licence `unknown` means that the source states none" in card
        assert front_matter((out / "README.md").read_text())["license"] == "other"
        row = Release.open(out).objects.to_pylist()[0]
        assert {row[k] for k in origin} == {UNKNOWN}


def test_hub_readers_see_fixed_size_rows(packed):
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(packed / "grasps" / "train-00000.parquet")
    assert len(frame["joints"][0]) == 2 * 3 * 3
    assert frame["suc_f"].notna().all()
    assert frame["suc_l"].isna().all()


def test_a_rate_without_trials_says_so():
    assert rate_text(rate_interval(0, 0).to_dict()) == "not available"
    assert rate_text(rate_interval(1, 2).to_dict()).startswith("50.0 % (")


def test_the_card_goes_by_the_tests_that_there_are(packed, lifted, tmp_path):
    untested = made_release(tmp_path / "untested", tested=False, tests=[])
    cards = [(p / "DATASET_CARD.md").read_text() for p in (packed, lifted, untested)]
    assert "Success is test `f` of" in cards[0]
    assert 'where="suc_f")' in cards[0]
    assert "Success is test `l` of" in cards[1]
    assert 'where="suc_l")' in cards[1]
    assert "Nothing was tested by protocol `paper-1`" in cards[2]
    assert "where=" not in cards[2]


def test_the_card_and_info_of_a_release_with_arms_name_the_rig(packed, tmp_path, capsys):
    armed = made_release(tmp_path / "armed", arms=True)
    card = (armed / "DATASET_CARD.md").read_text()
    assert "The rig is `made`: two made chains." in card
    assert "Hands: made left, made right. Arms: made.\n" in card
    assert "left Apache-2.0, right Apache-2.0" in card
    assert "C contacts, A arm joints, K key frames, W knots;" in card
    found = Release.open(armed).figures["tests"]["a"]
    assert f"| Selected reachable, test `a` | {rate_text(found['reachable']['selected'])} |" in card
    given = rate_text(found["given_reachable"]["unselected"])
    assert f"| Unselected given reachable, test `a` | {given} |" in card
    assert verify_release(armed, full=True).ok
    assert run(["info", str(armed)]) == 0
    assert "; arms of made" in capsys.readouterr().out
    plain = (packed / "DATASET_CARD.md").read_text()
    assert "## Arms" not in plain
    assert "reachable" not in plain
