"""A report as Markdown, with its pictures as files beside it."""

from zebrat_bullet.report.comparison.document import Block, Card, Cards, Document, Grid, Picture, Section, Text


def write_markdown(document: Document, pictures: str) -> str:
    """Return the text; `pictures` is the folder of the images, as seen from the file."""
    contents = "\n".join(line for section in document.sections for line in _entries(section, 0))
    body = "\n\n".join(_section(section, 2, pictures) for section in document.sections)
    return f"# {document.title}\n\n{document.lead.strip()}\n\n## Contents\n\n{contents}\n\n{body}\n"


def _entries(section: Section, depth: int) -> list[str]:
    line = f"{'  ' * depth}- [{section.title}](#{section.anchor})"
    return [line, *(entry for part in section.parts for entry in _entries(part, depth + 1))]


def _section(section: Section, level: int, pictures: str) -> str:
    parts = [f"{'#' * level} {section.title}"]
    parts += [_block(block, pictures) for block in section.blocks]
    parts += [_section(part, level + 1, pictures) for part in section.parts]
    return "\n\n".join(parts)


def _block(block: Block, pictures: str) -> str:
    match block:
        case Text(markdown):
            return markdown.strip()
        case Grid():
            return _grid(block)
        case Picture():
            return f"{_image(block, pictures)}" + (f"\n\n{block.caption}" if block.caption else "")
        case Cards(cards):
            return "\n\n".join(_card(card, pictures) for card in cards)


def _grid(grid: Grid) -> str:
    rows = [grid.head, tuple("---" for _ in grid.head), *(tuple(c.text for c in row) for row in grid.cells())]
    table = "\n".join("| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows)
    return table + (f"\n\n{grid.caption}" if grid.caption else "")


def _image(picture: Picture, pictures: str) -> str:
    return f"![{picture.alt}]({pictures}/{picture.file_name})"


def _card(card: Card, pictures: str) -> str:
    return f"**{card.title}**: {card.text}\n\n{_image(card.picture, pictures)}\n\n```sh\n{card.command}\n```"
