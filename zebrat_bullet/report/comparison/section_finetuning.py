"""What 500 episodes more from the best model do (paper, IV-B)."""

from collections.abc import Mapping, Sequence

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Kind, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import METHODS, TRACKS, Drive, Evidence, Scope, rate
from zebrat_bullet.report.comparison.numbers import MISSING
from zebrat_bullet.report.comparison.section_evaluation import WORLDS, comparison_blocks
from zebrat_bullet.report.comparison.statistics import LEVEL, Paired, holm, paired_test

Key = tuple[str, Scope]
_AFTER: tuple[tuple[Scope, str], ...] = (
    ("finetuned", "after, at the same rates"),
    ("cloning", "after, drawn to the actions of its replay, at a tenth of the actor's rate"),
)


def finetuning_section(evidence: Evidence) -> Section | None:
    """Return the section; None where nothing of it was driven."""
    before = {method: _by_place(evidence, "paper", method) for method in METHODS}
    after = {(method, scope): _by_place(evidence, scope, method) for method in METHODS for scope, _ in _AFTER}
    if not any(after.values()):
        return None
    tests = {key: _paired(before[key[0]], at) for key, at in after.items() if at and before[key[0]]}
    p_values = dict(zip(tests, holm([test.p for test in tests.values()]), strict=True))
    rows: list[Row] = []
    for method in METHODS:
        if at := before[method]:
            rows.append((method, "before", *_shares(at), *("",) * 3))
        for scope, words in _AFTER:
            if at := after[method, scope]:
                rows.append((method, words, *_shares(at), *_changes((method, scope), tests, p_values)))
    said = Text(
        "**The paper** trains each of its sets 500 episodes more from its best model, and evaluates that. **Ours** "
        "goes on from the policy that stands for the set above, with its critic and optimisers, and keeps it unless "
        "its own noise-free evaluations, of 4 episodes, find one that is no worse."
    )
    caption = (
        "Success in %, before and after. Gained and lost: starts of all these tracks from which only the one after, "
        f"only the one before leaves; McNemar's exact test, Holm-corrected over the rows (below {LEVEL:g}: in colour)."
    )
    head = ("set", "fine-tuning", *WORLDS, "Tracks 1 to 8", "gained", "lost", "p")
    blocks: list[Block] = [
        said,
        Grid(head, tuple(rows), caption),
        *comparison_blocks(evidence, "finetuned", METHODS, "finetuned"),
    ]
    return Section("After 500 episodes of fine-tuning", tuple(blocks))


def _by_place(evidence: Evidence, scope: Scope, method: str) -> dict[str, list[Drive]]:
    return {place: drives for place in WORLDS if (drives := evidence.shown(scope, method, place))}


def _shares(at: Mapping[str, Sequence[Drive]]) -> tuple[Cell, ...]:
    cells = [Cell(f"{100 * rate(at[place]).share:.0f}", "number") if place in at else MISSING for place in WORLDS]
    if not all(place in at for place in TRACKS):
        return (*cells, MISSING)
    return (*cells, Cell(f"{rate([drive for place in TRACKS for drive in at[place]])}"))


def _paired(before: Mapping[str, Sequence[Drive]], after: Mapping[str, Sequence[Drive]]) -> Paired:
    one, other = ([drive for of_place in at.values() for drive in of_place] for at in (after, before))
    return paired_test({d.start: d.success for d in one}, {d.start: d.success for d in other})


def _changes(key: Key, tests: Mapping[Key, Paired], p_values: Mapping[Key, float]) -> tuple[Cell, ...]:
    if key not in tests:
        return (MISSING,) * 3
    test, p = tests[key], p_values[key]
    kind: Kind = "" if p >= LEVEL else "good" if test.better > test.worse else "bad"
    counts = (Cell(str(n), "number") for n in (test.better, test.worse))
    return (*counts, Cell(f"{p:.2g}", kind))
