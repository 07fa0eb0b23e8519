import dataclasses
from pathlib import Path

import numpy as np
import pytest
from picture_samples import box_solid, grasps
from PIL import Image

from bidexdata.pictures.captions import grasp_caption, object_caption, outcome_words, verdict_words
from bidexdata.pictures.sheet import (
    BAD,
    GOOD,
    PAPER,
    Caption,
    Tile,
    captioned,
    contact_sheet,
    fitted,
    save_animation,
    save_picture,
    wrapped,
)
from bidexdata.record.status import Status, TestStage


def tile(value: int, caption: Caption) -> Tile:
    return Tile(np.full((40, 120, 3), value, np.uint8), caption)


def test_tiles_stand_in_a_grid_unchanged():
    tiles = [tile(10 * k, Caption(f"tile {k}", ("line",))) for k in range(5)]
    sheet = np.asarray(contact_sheet(tiles, title="title", footer="foot", columns=2))
    assert sheet.shape[1] == 2 * (120 + 10) + 10
    for k in range(5):
        rows, columns = np.nonzero(np.all(sheet == 10 * k, axis=2))
        inside = (columns >= 10 + (k % 2) * 130) & (columns < 130 + (k % 2) * 130)
        assert np.sum(inside) >= 40 * 120
        assert np.ptp(rows[inside]) >= 39


def test_every_word_is_drawn_and_another_word_draws_another_sheet():
    def drawn(head="a", line="b", title="t", footer="f"):
        made = contact_sheet([tile(0, Caption(head, (line,)))], title=title, footer=footer)
        return np.asarray(made)

    plain = drawn()
    assert np.array_equal(plain, drawn())
    for changed in (drawn(head="x"), drawn(line="x"), drawn(title="x"), drawn(footer="x")):
        assert changed.shape == plain.shape
        assert not np.array_equal(changed, plain)
    empty = drawn("", "", "", "")
    assert np.all(empty[-20:] == PAPER)  # the footer's place


def test_the_verdict_is_coloured():
    def colours(good):
        made = contact_sheet(
            [tile(0, Caption("a", ("wide words",) * len(good), good))], title="", footer=""
        )
        return {tuple(int(v) for v in c) for c in np.asarray(made).reshape(-1, 3)}

    for good in ((), (None,), (True,), (False,), (True, False), (None, False), (False, None)):
        wanted = {colour for word, colour in ((True, GOOD), (False, BAD)) if word in good}
        assert {GOOD, BAD} & colours(good) == wanted


@pytest.mark.parametrize("text", ["", "x", "a caption", "an object's very long name " * 20])
@pytest.mark.parametrize("width", [5, 60, 400])
def test_a_line_fits_its_place_and_keeps_both_ends(text, width):
    from PIL.ImageFont import load_default

    short = fitted(text, width, 13)
    assert load_default(13).getlength(short) <= max(width, load_default(13).getlength("…"))
    assert short == text or "…" in short
    if len(short) > 3:
        assert short[0] == text[0]
        assert short[-1] == text[-1]


@pytest.mark.parametrize("status", Status)
@pytest.mark.parametrize("width", [270, 470])
def test_a_long_caption_is_wrapped_between_words_and_keeps_them_all(status, width):
    from PIL.ImageFont import load_default

    text = outcome_words("f", status, 1)
    lines = wrapped(text, width)
    assert " ".join(lines).split() == text.split()
    assert all(load_default(13).getlength(line) <= width for line in lines)
    assert (len(lines) == 1) == (load_default(13).getlength(text) <= width)


def test_a_word_without_end_is_shortened_and_no_line_is_lost():
    long, lines = "x" * 300, wrapped("a " + "x" * 300 + " b", 100)
    assert lines == ("a", fitted(long, 100, 13), "b")
    assert wrapped("", 100) == ("",)


def test_wrapped_lines_make_room_under_every_picture():
    words = "fails: " + "the object moved farther than the limit " * 2
    short, long = (Caption("head", (line,), (False,)) for line in ("fails", words))
    pixels = np.zeros((40, 200, 3), np.uint8)
    extra = captioned(pixels, long).shape[0] - captioned(pixels, short).shape[0]
    assert extra == (len(wrapped(words, 190)) - 1) * 17
    last = captioned(pixels, long)[-24:]  # the last line is there, and in the colour of the first
    assert {tuple(int(v) for v in c) for c in last.reshape(-1, 3)} >= {BAD, PAPER}
    sheets = [contact_sheet([Tile(pixels, c)], title="", footer="") for c in (short, long)]
    assert sheets[1].height - sheets[0].height == (len(wrapped(words, 200)) - 1) * 17


def test_saving_gives_the_same_bytes_and_reads_back(tmp_path: Path):
    sheet = contact_sheet([tile(99, Caption("a"))], title="t", footer="f")
    save_picture(sheet, tmp_path / "a.png")
    save_picture(sheet, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), np.asarray(sheet))


@pytest.mark.parametrize("ending", ["gif", "png"])
def test_an_animation_holds_every_frame(tmp_path: Path, ending):
    frames = [contact_sheet([tile(v, Caption("a"))], title="t", footer="f") for v in (0, 120, 240)]
    save_animation(frames, tmp_path / f"a.{ending}")
    with Image.open(tmp_path / f"a.{ending}") as read:
        assert read.n_frames == 3
        for k, frame in enumerate(frames):
            read.seek(k)
            middle = (20, 50)  # inside the tile
            got = np.array(read.convert("RGB").getpixel(middle), int)
            assert np.abs(got - np.array(frame.getpixel(middle))).max() < 40


def test_an_empty_sheet_still_has_its_words():
    sheet = np.asarray(contact_sheet([], title="nothing", footer="here"))
    assert np.any(sheet != PAPER)


def test_captions_say_what_became_of_a_grasp(hands):
    batch = grasps(hands, box_solid("box0-00000000"))
    caption = grasp_caption({"f": batch}, 1)
    assert caption.head == "box0-00000000  500 mm"
    assert str(batch["grasp_id"][1]) in caption.lines[0]
    assert caption.good == (True,)
    failed = grasp_caption({"f": batch}, 0)
    assert failed.good == (False,)
    assert Status.SLIP.sentence in failed.lines[-1]
    never = grasp_caption({"f": batch, "l": batch}, len(batch) - 1)
    assert len(never.lines) == 2
    assert Status.NO_PLACEMENT.sentence in never.lines[-1]
    bare = {k: v for k, v in batch.columns.items() if k in ("object_id", "size_mm", "grasp_id")}
    words, good = verdict_words(dataclasses.replace(batch, columns=bare), 0)
    assert (words, good) == ("not validated", None)


def test_a_caption_has_the_verdict_of_every_test(hands):
    closed = grasps(hands, box_solid("box0-00000000"))
    other = np.where(closed["verdict_status"] == Status.OK, Status.NOT_LIFTED, Status.NOT_RUN)
    columns = {"verdict_status": other.astype(np.int8), "success": np.zeros(len(other), bool)}
    tested = {"f": closed, "l": dataclasses.replace(closed, columns={**closed.columns, **columns})}
    caption = grasp_caption(tested, 1)
    assert caption.lines[1] == "passes test f"
    assert caption.lines[2] == f"fails test l: {Status.NOT_LIFTED.sentence}"
    assert caption.good == (True, False)
    caption = grasp_caption(tested, 0)
    assert caption.lines[2] == "not validated by test l"
    assert caption.good == (False, None)


def test_an_object_thrown_before_the_hands_close_is_not_said_to_be_thrown_after(hands):
    batch = grasps(hands, box_solid("box0-00000000"))
    for stage, said in ((TestStage.APPROACH, "before the hands had"), (TestStage.LIFT, "when the")):
        columns = {
            "verdict_status": np.full(len(batch), Status.THROWN, np.int8),
            "success": np.zeros(len(batch), bool),
            "failed_stage": np.full(len(batch), stage, np.int8),
        }
        thrown = dataclasses.replace(batch, columns={**batch.columns, **columns})
        row = int(np.flatnonzero(thrown["synth_status"] == Status.OK)[0])
        assert f"beyond the limits {said}" in verdict_words(thrown, row, test="a")[0]


def test_a_load_direction_is_named(hands):
    batch = grasps(hands, box_solid("box0-00000000"))
    direction = np.full(len(batch), 5, np.int8)
    loaded = dataclasses.replace(batch, columns={**batch.columns, "direction": direction})
    assert "load -z" in verdict_words(loaded, 0)[0]


def test_an_object_caption_counts_pieces_and_warns():
    caption = object_caption(box_solid("box0-00000000"))
    assert caption.head == "box0-00000000"
    assert caption.lines[0] == "2 convex pieces · convex · licence CC0-1.0"
    assert caption.lines[1] == "a <warning>"


@pytest.mark.parametrize(
    ("warnings", "shown"),
    [
        ((), ""),
        (("1 hole closed, at most 0.0% of a component's area",), ""),
        (("1 hole closed, at most 4.0% of a component's area", "open parts with 2.0%"), 0),
        (("1 hole closed, at most 0.0% of it", "2 double faces dropped"), 1),
        (("2 double faces dropped", "open parts with 12.5% of the area dropped"), 1),
        (("open parts with 12.5%", "the repair is up to 2.1% of the diagonal from the file"), 1),
        (("seams of 9%", "the convex pieces have 1.40 times the volume of the mesh"), 1),
    ],
)
def test_an_object_caption_has_the_warning_that_says_most(warnings, shown):
    solid = box_solid("box0-00000000")
    warned = dataclasses.replace(solid, provenance={**solid.provenance, "warnings": warnings})
    said = object_caption(warned).lines[1]
    assert said == (shown if isinstance(shown, str) else warnings[shown])


def test_a_load_is_named_only_where_it_says_something():
    assert "(load -x)" in outcome_words("f", Status.SLIP, 1)
    assert "load" not in outcome_words("f", Status.NO_CONTACT, 1)
    assert outcome_words("f", Status.THROWN, 1) == (
        "fails test f: the object was beyond the limits when the hands had closed"
    )
    assert "(load" not in outcome_words("l", Status.SLIP, -1)


def test_a_title_that_is_too_long_is_wrapped_and_not_cut():
    tile = Tile(np.zeros((40, 200, 3), np.uint8), Caption("a"))
    low = contact_sheet([tile], title="short", footer="")
    high = contact_sheet([tile], title="a title that goes on, " * 5, footer="")
    assert high.size[0] == low.size[0]
    assert high.size[1] > low.size[1]


def test_a_picture_that_cannot_be_finished_leaves_what_was_there(tmp_path, monkeypatch):
    out = tmp_path / "a.png"
    out.write_bytes(b"old")
    broken = Image.new("RGB", (4, 4))

    def stop(file, **_):
        Path(file).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(broken, "save", stop)
    with pytest.raises(KeyboardInterrupt):
        save_picture(broken, out)
    assert out.read_bytes() == b"old"
