"""The page in a real browser: grasps are drawn, and two windows do not turn each other's pages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from armed_source import armed_source
from chromium import Chromium, Window, find_chromium, wait_until
from made_release import OBJECTS, made_release, made_rows

from bidexdata.cli.main import run
from bidexdata.formats.release import Release
from bidexdata.hands import load_hands
from bidexdata.viewer.app import serve, serve_source
from bidexdata.viewer.server import free_port, silent

pytestmark = pytest.mark.slow

DRAWN = 1000
"""Pixels of a hand's colour in a window: one hand alone has more."""


@pytest.fixture(scope="module")
def chromium():
    program = find_chromium()
    if program is None:
        pytest.skip("needs chromium or chrome: on the PATH, or named by CHROMIUM")
    pytest.importorskip("websockets.sync.client", reason="comes with viser")
    started = Chromium(program)
    yield started
    started.close()


@pytest.fixture
def browser(chromium):
    yield chromium
    chromium.close_windows()


@pytest.fixture(scope="module")
def release(tmp_path_factory) -> Path:
    out, hands = tmp_path_factory.mktemp("browser") / "release", load_hands("capsule")

    def rows_of(object_id):
        rows = made_rows(object_id, hands=hands)
        pos = rows.batch["hand_pos"]  # moved beside the object, where the camera looks
        pos *= 0.1
        pos[..., 0] += np.array([-0.16, 0.16], np.float32)[:, None]
        return [rows]

    return made_release(out, hands=hands, rows_of=rows_of)


@pytest.fixture(scope="module")
def address(release):
    server = serve(release, port=free_port(), block=False)
    yield f"http://127.0.0.1:{server.get_port()}"
    with silent():
        server.stop()


def colours(picture: Path) -> np.ndarray:
    """Pixels that are rather blue, rather green, and neither but not grey, (3,)."""
    from PIL import Image

    r, g, b = np.moveaxis(np.asarray(Image.open(picture).convert("RGB"), int)[:, :845], 2, 0)
    blue, green = (b > r + 60) & (b > g + 30), (g > r + 40) & (g > b + 10)
    return np.array([blue.sum(), green.sum(), (r > b + 30).sum()])


def nothing_cut_off(picture: Path) -> bool:
    """Whether no pixel of hands or object lies at the borders of what the panel leaves free."""
    pixels = image(picture)
    strong = pixels.max(axis=2) - pixels.min(axis=2) > 60
    return not np.concatenate(
        [strong[:4].ravel(), strong[-4:].ravel(), strong[:, [0, -1]].ravel()]
    ).any()


def wait_until_drawn(window: Window, path: Path) -> None:
    """Wait for both hands and the object to be on the page; the picture stays for people."""
    try:
        wait_until(lambda: bool((colours(window.picture(path)) > DRAWN).all()), "a picture")
    except TimeoutError as err:
        raise AssertionError(f"{path}: blue, green, beige pixels {colours(path)}") from err


def test_two_windows_show_grasps_and_keep_their_own_state(browser, address, release, tmp_path):
    total = f"{shown_rows(release):,} grasps of 3 objects match."
    one, two = browser.open(address), browser.open(address)
    for window in (one, two):
        window.wait_for(total)
        window.wait_for(OBJECTS[0])
    for number, window in enumerate((one, two)):
        wait_until_drawn(window, tmp_path / f"{number}.png")
        assert nothing_cut_off(tmp_path / f"{number}.png")

    one.type_into("object has", "TETRA")
    one.wait_for("of 1 object match.")
    one.wait_for(OBJECTS[2])
    one.press("n")
    one.wait_for("2 of ")
    one.choose("size", "500 mm")
    one.wait_for("1 of 6 grasps of this object")
    one.wait_for("500 mm, floating")
    assert total in two.text()
    assert OBJECTS[2] not in two.text()
    assert "300 mm, floating" in two.text()

    two.click("next object")
    two.wait_for(OBJECTS[1])
    two.choose("outcome", "failed")
    two.wait_for("fails test f")
    assert OBJECTS[1] not in one.text()
    assert "1 of 6 grasps of this object" in one.text()

    one.type_into("object has", "no such thing")
    one.wait_for("0 grasps of 0 objects match.")
    one.wait_for("No grasp matches the filters.")
    one.click("clear filters")
    one.wait_for(total)


def test_letters_typed_into_the_text_box_are_no_keys(browser, address):
    window = browser.open(address)
    window.wait_for("1 of ")
    grasp = re.search(r"grasp ([0-9a-f]{16})", window.text())
    window.type_into("object has", "")
    for letter in "on":
        window.press_here(letter)
    window.wait_for("0 objects")
    window.click("clear filters")
    window.wait_for("3 objects match.")
    assert grasp
    window.wait_for(grasp[1])


def test_an_exported_grasp_opens_without_a_server(browser, release, tmp_path, capsys):
    rows = Release.open(release).grasps(OBJECTS[0])
    out = tmp_path / "grasp.html"
    wanted = str(rows["grasp_id"][1])
    assert run(["view", str(release), "--export", wanted[:9], "--out", str(out)]) == 0
    assert capsys.readouterr().out.startswith(f"{out}: grasp {wanted} of {OBJECTS[0]}, ")
    window = browser.open(out.as_uri())
    window.wait_for(wanted)
    window.wait_for("test f")
    wait_until_drawn(window, tmp_path / "page.png")


def test_arms_are_drawn_and_the_time_slider_moves_them(browser, tmp_path):
    hands = load_hands("capsule")
    server = serve_source(armed_source(hands, tmp_path), port=free_port())
    try:
        window = browser.open(f"http://127.0.0.1:{server.get_port()}")
        window.wait_for("arms: made takes it in 2.9 s")
        window.wait_for("time [s]")
        with_arms = window.picture(tmp_path / "a.png")
        wait_until(lambda: pale(window.picture(with_arms)) > DRAWN, "arms")
        before = image(with_arms)
        window.press("1")  # another time
        wait_until(
            lambda: np.abs(image(window.picture(with_arms)) - before).max() > 60, "a movement"
        )
        window.press("n")
        window.wait_for("jump")
        assert "time [s]" not in window.text()
    finally:
        with silent():
            server.stop()


def image(picture: Path) -> np.ndarray:
    """Pixels beside the widgets, (h, w, 3)."""
    from PIL import Image

    return np.asarray(Image.open(picture).convert("RGB"), int)[:, :845]


def pale(picture: Path) -> int:
    """Pixels of the arms' colours: neither white nor grey, nor as strong as hands and object."""
    pixels = image(picture)
    spread = pixels.max(axis=2) - pixels.min(axis=2)
    return int(((spread > 12) & (spread < 60) & (pixels.max(axis=2) < 235)).sum())


def shown_rows(release: Path) -> int:
    """Rows with a pose: all but one audit row of each of the six scenes."""
    return len(Release.open(release).stored()) - 6
