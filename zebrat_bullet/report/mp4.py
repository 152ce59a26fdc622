"""Pictures to an MP4 (H.264), one at a time."""

from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import RenderError


def check_mp4(path: Path, size: tuple[int, int]) -> None:
    """Refuse what the encoder does not take, before anything is drawn.

    Raises:
        RenderError: another suffix than .mp4, or an odd width or height.
    """
    if path.suffix != ".mp4":
        raise RenderError(f"a video's name ends in .mp4, got {path.name!r}")
    if size[0] % 2 or size[1] % 2:
        raise RenderError(f"H.264 takes even widths and heights, got {size[0]}x{size[1]}")


def write_mp4(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: int, size: tuple[int, int]) -> None:
    """Write (height, width, 3) pictures as a video of the given (width, height), whole or not at all.

    Raises:
        RenderError: see `check_mp4`.
    """
    check_mp4(path, size)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.part.mp4")
    stream = imageio_ffmpeg.write_frames(
        str(part),
        size,
        fps=fps,
        codec="libx264",
        quality=5.5,
        macro_block_size=2,
        output_params=["-preset", "veryfast", "-movflags", "+faststart"],
    )
    stream.send(None)
    try:
        try:
            for picture in pictures:
                stream.send(np.ascontiguousarray(picture))
        finally:
            stream.close()
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
