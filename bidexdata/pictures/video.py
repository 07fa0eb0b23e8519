"""Videos as .mp4 that every browser and slide program plays: H.264, 4:2:0, even sizes.

The package `av` brings FFmpeg's libraries with an encoder; nothing else has to be installed.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import MissingExtra, NotUsable

if TYPE_CHECKING:
    from PIL.Image import Image

ENCODER = "libx264"
QUALITY = 20
"""Constant rate factor of the encoder [-]: 0 is lossless, 18 to 23 looks it."""


def require_encoder() -> None:
    """Refuse to go on where no video can be written.

    Raises:
        MissingExtra: The package `av` is not installed.
        NotUsable: It has no H.264 encoder.
    """
    av = _av()
    if ENCODER not in av.codecs_available:
        raise NotUsable(
            f"this build of the package 'av' has no encoder {ENCODER}; the one from the package "
            "index has: pip install --force-reinstall --only-binary :all: av"
        )


def save_video(
    frames: Iterable[NDArray[np.uint8] | Image], path: str | Path, fps: float | int = 25.0
) -> None:
    """Write pictures that follow each other as an .mp4; the same pictures give the same bytes.

    Args:
        frames: sRGB pixels (h, w, 3) or pictures of one size, at least one; they are taken one at
            a time. An odd width or height is made even by repeating the last column or row.
        path: The file, replaced if it is there; nothing is left where writing fails.
        fps: Pictures per second.

    Raises:
        MissingExtra: The package `av` is not installed.
        NotUsable: It has no H.264 encoder.
        ValueError: No picture, pictures of different sizes, or a rate that is not positive.
    """
    require_encoder()
    path, pictures = Path(path), iter(frames)
    if not fps > 0:
        raise ValueError(f"fps must be positive, not {fps}")
    first = next(pictures, None)
    if first is None:
        raise ValueError(f"{path}: a video needs at least one picture")
    unfinished = path.with_name(f".{path.name}.tmp")
    try:
        _encode(chain([first], pictures), unfinished, Fraction(fps).limit_denominator(1000))
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _encode(frames: Iterable[NDArray[np.uint8] | Image], path: Path, rate: Fraction) -> None:
    av = _av()
    # One thread, so that the bytes do not depend on the machine's cores.
    options = {"crf": str(QUALITY), "preset": "medium", "threads": "1"}
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream(ENCODER, rate=rate, options=options)
        size = (0, 0)
        for frame in frames:
            pixels = _even(np.asarray(frame, np.uint8))
            if size == (0, 0):
                size = pixels.shape[:2]
                _describe(stream, size)
            if pixels.shape[:2] != size:
                raise ValueError(f"{path}: pictures of {size} and {pixels.shape[:2]} pixels")
            container.mux(stream.encode(_yuv(av, pixels)))
        container.mux(stream.encode())


def _describe(stream: Any, size: tuple[int, int]) -> None:
    """Set size and format; players guess the colours of a video that does not say how it has them."""
    stream.height, stream.width = size
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.color_primaries = context.color_trc = context.colorspace = _BT709
    context.color_range = _LIMITED


def _yuv(av: Any, pixels: NDArray[np.uint8]) -> Any:
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
    return frame.reformat(format="yuv420p", dst_colorspace=_BT709, dst_color_range=_LIMITED)


def _even(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = pixels.shape[:2]
    return np.pad(pixels[..., :3], ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _av() -> Any:
    try:
        import av
    except ModuleNotFoundError as err:
        raise MissingExtra("av", "synth") from err
    return av


# FFmpeg's numbers (ITU-T H.273).
_BT709 = 1
_LIMITED = 1
