"""Pictures to an MP4 (H.264), one at a time."""

import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import RenderError
from zebrat_bullet.files import shown
from zebrat_bullet.outputs import written_whole


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

    Not by imageio's own writer, which does not ask whether the encoder ended well.

    Raises:
        RenderError: see `check_mp4`; or the encoder failed, as on a full disk.
    """
    check_mp4(path, size)
    with written_whole(path) as part, tempfile.TemporaryFile() as said:
        # In a session of its own: Ctrl-C is for the caller to answer.
        with subprocess.Popen(
            _command(part, fps, size), stdin=subprocess.PIPE, stderr=said, start_new_session=True
        ) as encoder:
            assert encoder.stdin is not None
            try:
                for picture in pictures:
                    if not _taken(encoder.stdin, np.ascontiguousarray(picture)):
                        break
            except BaseException:
                encoder.kill()
                raise
            finally:
                _taken(encoder.stdin, None)
        if encoder.returncode != 0:
            said.seek(0)
            words = said.read().decode(errors="replace").split() or [f"status {encoder.returncode}"]
            raise RenderError(
                f"{shown(path)}: the encoder could not write it ({shown(' '.join(words), 300)}); make room on its "
                "disk, or name another place"
            )


def _taken(pipe: IO[bytes], picture: NDArray[np.uint8] | None) -> bool:
    """Write a picture, or close the pipe after the last; return whether the encoder still takes them."""
    try:
        pipe.close() if picture is None else pipe.write(picture.data)
    except BrokenPipeError:
        return False
    return True


def _command(path: Path, fps: int, size: tuple[int, int]) -> list[str]:
    """Return the encoder's command; it takes raw pictures from its standard input."""
    taken = ("-f", "rawvideo", "-s", f"{size[0]}x{size[1]}", "-pix_fmt", "rgb24", "-r", str(fps), "-i", "-")
    made = ("-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "22", "-preset", "veryfast")
    return [
        *(imageio_ffmpeg.get_ffmpeg_exe(), "-y", *taken, *made, "-v", "error"),
        *("-movflags", "+faststart", "-f", "mp4", str(path)),
    ]
