"""What a report consists of, whichever way it is written: sections of text, tables, pictures and cards."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Kind = Literal["", "good", "bad", "open", "missing", "number"]
"""How a cell is shown where there are colours: its words say the same."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table; its text is inline Markdown."""

    text: str
    kind: Kind = ""


Row = tuple[Cell | str, ...]


@dataclass(frozen=True, slots=True)
class Text:
    """Paragraphs in Markdown."""

    markdown: str


@dataclass(frozen=True, slots=True)
class Grid:
    """A table: a row of headings, rows as long, and what is to be known to read it."""

    head: tuple[str, ...]
    rows: tuple[Row, ...]
    caption: str = ""
    wordy: bool = False
    """Cells are sentences: they wrap, and on a phone each row is a block."""

    def cells(self) -> list[list[Cell]]:
        """Return the rows with every cell as a `Cell`."""
        return [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]


@dataclass(frozen=True, slots=True)
class Picture:
    """An image.

    Attributes:
        name: its file's name where pictures are files: unique in a report.
        data: an SVG or a PNG.
        alt: what it shows, for those who do not see it.
        caption: what is to be known to read it.
    """

    name: str
    data: bytes
    alt: str
    caption: str = ""

    @property
    def is_svg(self) -> bool:
        """Whether it is an SVG, not a PNG."""
        return not self.data.startswith(b"\x89PNG")

    @property
    def file_name(self) -> str:
        """Its name with the ending of its format."""
        return f"{self.name}.{'svg' if self.is_svg else 'png'}"


@dataclass(frozen=True, slots=True)
class Card:
    """A small picture with its words, and a command that shows the same."""

    picture: Picture
    title: str
    text: str
    command: str


@dataclass(frozen=True, slots=True)
class Cards:
    """Cards beside one another."""

    cards: tuple[Card, ...]


Block = Text | Grid | Picture | Cards


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part: blocks, then parts of its own."""

    title: str
    blocks: tuple[Block, ...] = ()
    parts: tuple["Section", ...] = ()
    folded: bool = False
    """Whether a browser shows it only when it is asked for."""

    @property
    def anchor(self) -> str:
        """What its heading is called in links."""
        return re.sub(r"[^\w\- ]", "", self.title.lower()).strip().replace(" ", "-")

    def pictures(self) -> Iterator[Picture]:
        """Yield every image of the section and its parts."""
        for block in self.blocks:
            if isinstance(block, Picture):
                yield block
            elif isinstance(block, Cards):
                yield from (card.picture for card in block.cards)
        for part in self.parts:
            yield from part.pictures()


@dataclass(frozen=True, slots=True)
class Document:
    """A report: its title, what stands before the contents, and its sections."""

    title: str
    lead: str
    sections: tuple[Section, ...]
