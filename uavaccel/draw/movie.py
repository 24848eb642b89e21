"""An encoder of images as H.264 in an MP4, which every browser plays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from uavaccel.draw.panels import Bgr
from uavaccel.errors import UserError, naming
from uavaccel.files import replacing

# x264's options for images half of text and edges: bits go where the error is, so that counting numbers stay legible.
# The event of a single pixel is still visible. The preset medium halves the file and takes five times as long.
X264 = {"crf": "38", "preset": "ultrafast", "aq-mode": "0", "psy": "0", "x264-params": "cabac=1"}
BT709, BT601, LIMITED_RANGE = 1, 6, 1  # as FFmpeg and H.264 number them: players need not guess


@contextmanager
def movie(path: Path, size: tuple[int, int], frames_per_s: int) -> Iterator[Callable[[Bgr], None]]:
    """Yield a function that adds an image of `size` (width, height) to an MP4, which is written whole or not at all.

    It is H.264 in 4:2:0 with the index in front, so that it plays from the first byte on, encoded in one thread and
    without dates, so that equal films are equal files. Raises UserError where it cannot be written, at the end too if
    the first error was caught.
    """
    import av  # FFmpeg is needed for films alone

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file, _encoding(file.name, size, frames_per_s) as add:
            yield add
    except (OSError, av.FFmpegError, av.codec.codec.UnknownCodecError) as error:
        raise UserError(f"{path}: cannot be written: {error}") from error


@contextmanager
def _encoding(name: str, size: tuple[int, int], frames_per_s: int) -> Iterator[Callable[[Bgr], None]]:
    import av

    with av.open(name, "w", format="mp4", options={"movflags": "+faststart", "fflags": "+bitexact"}) as file:
        stream = file.add_stream("libx264", rate=frames_per_s, options=X264)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        context = stream.codec_context
        context.thread_count = 1
        context.color_primaries = context.color_trc = BT709
        context.colorspace = BT601  # the luma of OpenCV, which converts five times as fast as FFmpeg
        context.color_range = LIMITED_RANGE

        refused: list[str] = []

        def encode(frame: av.VideoFrame | None) -> None:
            if refused:  # PyAV crashes if it goes on with a file whose beginning could not be written
                raise UserError(refused[0])
            try:
                with naming(Path(name)):
                    file.mux(stream.encode(frame))
            except UserError as error:
                refused.append(str(error))
                raise

        def add(picture: Bgr) -> None:
            planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), np.uint8)
            encode(av.VideoFrame.from_ndarray(planes, format="yuv420p"))

        yield add
        encode(None)
