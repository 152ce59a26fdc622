"""The panel of numbers below the views: who drives where, time, outcome, speed, steering, clearance, reward terms."""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from zebrat_bullet.render.frame import Frame
from zebrat_bullet.render.scene import gap_color

_FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_Color = tuple[int, int, int]
_BACKGROUND, _TRACK = (18, 21, 27), (46, 52, 63)
_TEXT, _MUTED = (238, 241, 246), (146, 157, 173)
_GOOD, _BAD, _ACCENT = (74, 214, 120), (255, 92, 80), (92, 158, 255)
_HEIGHT_SHARE = 0.17
_FULL_SPEED_MPS = _FULL_STEERING_RAD = 0.6
_FULL_TERM = 12.0  # a reward term this large fills its half of the bar
# Left edge and width of each column, as shares of the picture's width.
_TITLE, _SPEED, _STEERING, _GAP, _TERMS = (0.015, 0.25), (0.28, 0.13), (0.43, 0.13), (0.58, 0.11), (0.715, 0.27)


class Hud:
    """Draws panels as wide as the picture.

    Attributes:
        height: of the panel in px.
    """

    def __init__(self, width: int, height: int) -> None:
        self.height = 2 * round(_HEIGHT_SHARE * height / 2)
        self._width = width
        text = min(self.height / 5.6, width / 62)
        self._small = ImageFont.truetype(_FONTS / "DejaVuSans.ttf", text * 0.85)
        self._large = ImageFont.truetype(_FONTS / "DejaVuSans-Bold.ttf", text * 1.15)

    def panel(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the (height, width, 3) panel of one moment."""
        image = Image.new("RGB", (self._width, self.height), _BACKGROUND)
        self._draw = ImageDraw.Draw(image)
        self._title(frame)
        self._gauge(_SPEED, "speed", f"{frame.speed_mps:+.2f} m/s", frame.speed_mps / _FULL_SPEED_MPS)
        # Left steering is positive and points left on the screen.
        degrees = np.degrees(frame.steering_rad)
        self._gauge(_STEERING, "steering", f"{degrees:+.0f}°", -frame.steering_rad / _FULL_STEERING_RAD)
        self._gap(frame.gap_m)
        for row, (name, value) in enumerate(frame.terms.items()):
            self._term(row, len(frame.terms), name, value)
        return np.asarray(image)

    def _title(self, frame: Frame) -> None:
        x = _TITLE[0] * self._width
        self._text(x, 0.24, frame.title, _TEXT, self._large)
        self._text(x, 0.53, f"{frame.time_s:.1f} s", _MUTED, self._small)
        color = _GOOD if frame.status == "success" else _BAD
        self._text(x, 0.80, frame.status.replace("_", " ").upper(), color, self._large)

    def _gauge(self, column: tuple[float, float], label: str, value: str, share: float) -> None:
        x, width = column[0] * self._width, column[1] * self._width
        self._text(x, 0.24, label, _MUTED, self._small)
        self._text(x, 0.53, value, _TEXT, self._large)
        self._bar(x, width, 0.80, 0.10, share, _ACCENT)

    def _gap(self, gap_m: float | None) -> None:
        if gap_m is None:
            return
        x = _GAP[0] * self._width
        red, green, blue = gap_color(gap_m)
        color = round(255 * red), round(255 * green), round(255 * blue)
        self._text(x, 0.24, "clearance", _MUTED, self._small)
        self._text(x, 0.53, f"{max(gap_m, 0.0):.2f} m", color, self._large)

    def _term(self, row: int, n_rows: int, name: str, value: float) -> None:
        y = 0.08 + 0.84 * (row + 0.5) / n_rows
        x, width = _TERMS[0] * self._width, _TERMS[1] * self._width
        self._text(x, y, name, _MUTED, self._small)
        self._bar(x + 0.09 * width, 0.66 * width, y, 0.10, value / _FULL_TERM, _GOOD if value > 0 else _BAD)
        self._text(x + width, y, f"{value:+.1f}", _TEXT, self._small, anchor="rm")

    def _text(
        self, x: float, y_share: float, text: str, color: _Color, font: ImageFont.FreeTypeFont, anchor: str = "lm"
    ) -> None:
        self._draw.text((x, y_share * self.height), text, fill=color, font=font, anchor=anchor)

    def _bar(self, x: float, width: float, y_share: float, thickness: float, share: float, color: _Color) -> None:
        """Draw a bar that grows from the middle of its track, to the right for positive shares of its half."""
        top, bottom = (y_share - thickness / 2) * self.height, (y_share + thickness / 2) * self.height
        middle = x + width / 2
        end = middle + float(np.clip(share, -1.0, 1.0)) * width / 2
        self._draw.rectangle((x, top, x + width, bottom), fill=_TRACK)
        self._draw.rectangle((min(middle, end), top, max(middle, end), bottom), fill=color)
        self._draw.line((middle, top - 1, middle, bottom + 1), fill=_MUTED)
