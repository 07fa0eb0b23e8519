"""Laws of videos: what was put in comes out, in the format that every player knows."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bidexdata.errors import MissingExtra
from bidexdata.pictures.video import save_video

# 4:2:0 at constant rate factor 20: flat patches come back within a few of 255 levels.
LOSS = 6


def pictures(n=5, height=48, width=64):
    """Patches of strong colours; the left one brightens."""
    frames = np.zeros((n, height, width, 3), np.uint8)
    frames[:, :, : width // 2, 0] = 40 * np.arange(n)[:, None, None]
    frames[:, :, width // 2 :] = (40, 60, 200)
    return frames


def opened(path: Path):
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        about = (stream.codec_context.name, stream.codec_context.pix_fmt, stream.average_rate)
        return about, [f.to_ndarray(format="rgb24") for f in container.decode(stream)]


@pytest.mark.parametrize("fps", [1, 25, 29.97, 1000 / 110])
def test_a_video_reads_back_frame_by_frame(tmp_path: Path, fps):
    frames = pictures()
    save_video(frames, tmp_path / "a.mp4", fps)
    (codec, pixels, rate), back = opened(tmp_path / "a.mp4")
    assert (codec, pixels) == ("h264", "yuv420p")
    assert float(rate) == pytest.approx(fps, rel=1e-3)
    assert len(back) == len(frames)
    # Away from edges, where halved colour resolution blurs.
    for made, got in zip(frames, back, strict=True):
        for column in (10, 54):
            assert np.abs(made[20, column].astype(int) - got[20, column]).max() <= LOSS


@pytest.mark.parametrize("size", [(1, 1), (49, 64), (48, 65), (49, 65)])
def test_odd_sizes_become_even_without_losing_a_pixel(tmp_path: Path, size):
    save_video(pictures(2, *size), tmp_path / "a.mp4")
    _, back = opened(tmp_path / "a.mp4")
    assert back[0].shape[:2] == (size[0] + size[0] % 2, size[1] + size[1] % 2)


def test_pictures_and_arrays_give_the_same_bytes_twice(tmp_path: Path):
    frames = pictures()
    save_video((f for f in frames), tmp_path / "a.mp4", 10)
    save_video([Image.fromarray(f) for f in frames], tmp_path / "b.mp4", 10.0)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_failed_video_leaves_nothing_and_an_old_one_alone(tmp_path: Path):
    path = tmp_path / "a.mp4"
    for wrong in ([], [pictures(1)[0], pictures(1, 60, 64)[0]]):
        with pytest.raises(ValueError, match=r"a\.mp4"):
            save_video(wrong, path)
        assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="fps"):
        save_video(pictures(), path, 0)
    save_video(pictures(), path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="pixels"):
        save_video([pictures(1)[0], pictures(1, 60, 64)[0]], path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_package_is_one_sentence_with_the_line_that_installs_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtra, match=r"'av'.*pip install 'bidexdata\[synth\]'"):
        save_video(pictures(), tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())
