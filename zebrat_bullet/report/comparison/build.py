"""The report from its tables: what it holds, in which order."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zebrat_bullet.comparison.manifest import Manifest
from zebrat_bullet.comparison.tables import read_tables
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_text, shown
from zebrat_bullet.outputs import require_writable, written_whole
from zebrat_bullet.report.comparison.document import Document, Section, Text
from zebrat_bullet.report.comparison.evidence import Evidence
from zebrat_bullet.report.comparison.html import write_html
from zebrat_bullet.report.comparison.markdown import write_markdown
from zebrat_bullet.report.comparison.section_claims import claims_section
from zebrat_bullet.report.comparison.section_drives import atlas_section, manoeuvre_section, paths_section
from zebrat_bullet.report.comparison.section_evaluation import ablation_section, evaluation_section
from zebrat_bullet.report.comparison.section_finetuning import finetuning_section
from zebrat_bullet.report.comparison.section_run import run_section
from zebrat_bullet.report.comparison.section_scale import rivals_section, scale_section
from zebrat_bullet.report.comparison.section_training import collision_section, curve_section
from zebrat_bullet.report.comparison.section_words import differences_section, words_section
from zebrat_bullet.report.comparison.settings import asked_for, asked_runs

NOTES = "notes.md"
IN_SHORT = "\n---\n"
"""What stands above this in the notes goes to the top of the report."""
FORMATS = (".html", ".md")
_TITLE = "Driving out of narrow passages: the paper's comparison, again and at scale"
_LEAD = """\
Seven ways to drive a car-like robot out of narrow passages, compared as in *Unguided Self-exploration in Narrow Spaces
with Safety Region Enhanced Reinforcement Learning for Ackermann-steering Robots* (Tian, Liu, Zhou, Shi, IEEE MOST 2024,
[arXiv 2209.08349](https://arxiv.org/abs/2209.08349)): at the paper's own budget, and with many times its training.

{in_short}**{claims}**

Every table, figure and verdict here is computed from five tables of records: `zebrat report --records FOLDER --out
FILE` makes this page from them again, byte for byte; `zebrat reproduce` makes the tables. What is in short
above, and "What was learned, and why", is written by hand and says where its other numbers come from.
"""


def make_document(tables: Mapping[str, Any], manifest: Manifest, notes: str = "") -> Document:
    """Return the report.

    Args:
        tables: the five of `zebrat_bullet.comparison.tables`, by name.
        manifest: what was to be driven; what of it is not in the tables is marked as missing.
        notes: what was learned and why, Markdown, included as it is: above a line `---`, if there is one, in short.
    """
    evidence = Evidence(tables)
    claims, lead = claims_section(evidence)
    in_short, _, notes = notes.rpartition(IN_SHORT)
    finetuned = finetuning_section(evidence)
    learned = (Section("What was learned, and why", (Text(notes),)),) if notes.strip() else ()
    sections = (
        words_section(),
        claims,
        *learned,
        differences_section(),
        run_section(evidence, asked_for(manifest, evidence), asked_runs(manifest)),
        collision_section(evidence),
        curve_section(evidence),
        evaluation_section(evidence),
        ablation_section(evidence),
        *((finetuned,) if finetuned else ()),
        scale_section(evidence),
        rivals_section(evidence),
        manoeuvre_section(evidence),
        paths_section(evidence),
        atlas_section(evidence, manifest),
    )
    in_short = f"{in_short.strip()}\n\n" if in_short.strip() else ""
    return Document(_TITLE, _LEAD.format(claims=lead, in_short=in_short), sections)


def build_report(records: Path, out: Path, manifest: Manifest) -> list[Path]:
    """Write the report on the tables in a folder, with the notes beside them; the same tables give the same bytes.

    Args:
        records: the folder; NAME.parquet of each table, and notes.md if there is one.
        out: FILE.html, which holds everything, or FILE.md, whose pictures go into the folder FILE_pictures beside it.
        manifest: what was to be driven.

    Returns:
        The files written.

    Raises:
        ConfigError: a table is missing or damaged, or `out` ends in something else.
    """
    if out.suffix not in FORMATS:
        raise ConfigError(
            f"a report is written as {' or '.join(FORMATS)}; got {shown(out.name)!r}, name --out FILE.html"
        )
    require_writable(out)
    tables = read_tables(records)
    notes = read_text(records / NOTES, ConfigError) if (records / NOTES).exists() else ""
    document = make_document(tables, manifest, notes)
    if out.suffix == ".html":
        with written_whole(out) as part:
            part.write_text(write_html(document), encoding="utf-8")
        return [out]
    folder = out.with_name(f"{out.stem}_pictures")
    with written_whole(out) as part:
        part.write_text(write_markdown(document, folder.name), encoding="utf-8")
    folder.mkdir(exist_ok=True)
    written = [out]
    for section in document.sections:
        for picture in section.pictures():
            path = folder / picture.file_name
            path.write_bytes(picture.data)
            written.append(path)
    return written
