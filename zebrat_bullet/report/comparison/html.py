"""A report as one HTML file: nothing is fetched, nothing runs."""

import base64
from html import escape
from importlib.resources import files

from markdown_it import MarkdownIt

from zebrat_bullet.report.comparison.document import Block, Card, Cards, Cell, Document, Grid, Picture, Section, Text

# Raw HTML stays text and an image is not shown: either could fetch something.
_MARKDOWN = MarkdownIt("commonmark", {"html": False}).enable("table").disable("image")


def write_html(document: Document) -> str:
    """Return the file's text."""
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    contents = "".join(_entry(section) for section in document.sections)
    body = "".join(_section(section, 2) for section in document.sections)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(document.title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        f"<header><h1>{escape(document.title)}</h1>\n{_MARKDOWN.render(document.lead)}</header>\n"
        f'<nav aria-label="Contents"><h2>Contents</h2>\n<ol>{contents}</ol></nav>\n{body}</main>\n</body>\n</html>\n'
    )


def _entry(section: Section) -> str:
    parts = "".join(_entry(part) for part in section.parts if not part.folded)
    below = f"<ol>{parts}</ol>" if parts else ""
    return f'<li><a href="#{section.anchor}">{escape(section.title)}</a>{below}</li>\n'


def _section(section: Section, level: int) -> str:
    heading = f'<h{level} id="{section.anchor}">{escape(section.title)}</h{level}>\n'
    inside = "".join(map(_block, section.blocks)) + "".join(_section(part, level + 1) for part in section.parts)
    if section.folded:
        return f"<details><summary>{heading}</summary>\n{inside}</details>\n"
    return f"<section>\n{heading}{inside}</section>\n"


def _block(block: Block) -> str:
    match block:
        case Text(markdown):
            return _MARKDOWN.render(markdown)
        case Grid():
            return _grid(block)
        case Picture():
            return f"<figure>{_image(block)}{_caption(block.caption)}</figure>\n"
        case Cards(cards):
            return f'<div class="cards">\n{"".join(map(_card, cards))}</div>\n'


def _grid(grid: Grid) -> str:
    head = "".join(f'<th scope="col">{_MARKDOWN.renderInline(text)}</th>' for text in grid.head)
    rows = []
    for first, *rest in grid.cells():
        cells = "".join(map(_cell, rest, grid.head[1:]))
        rows.append(f'<tr><th scope="row">{_MARKDOWN.renderInline(first.text)}</th>{cells}</tr>\n')
    table = f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(rows)}</tbody></table>"
    wordy = " wordy" if grid.wordy else ""
    label = f'role="region" aria-label="{escape("table: " + ", ".join(grid.head))}"'
    wide = f'<div class="wide" tabindex="0" {label}>{table}</div>'
    return f'<figure class="grid{wordy}">{wide}{_caption(grid.caption)}</figure>\n'


def _cell(cell: Cell, head: str) -> str:
    kind = f' class="{cell.kind}"' if cell.kind else ""
    return f'<td{kind} data-head="{escape(head)}">{_MARKDOWN.renderInline(cell.text)}</td>'


def _caption(text: str) -> str:
    return f"<figcaption>{_MARKDOWN.renderInline(text)}</figcaption>" if text else ""


def _image(picture: Picture) -> str:
    kind = "svg+xml" if picture.is_svg else "png"
    data = base64.b64encode(picture.data).decode()
    return f'<img src="data:image/{kind};base64,{data}" alt="{escape(picture.alt)}">'


def _card(card: Card) -> str:
    return (
        f"<article>{_image(card.picture)}<div><h4>{escape(card.title)}</h4><p>{_MARKDOWN.renderInline(card.text)}</p>"
        f"<pre><code>{escape(card.command)}</code></pre></div></article>\n"
    )
