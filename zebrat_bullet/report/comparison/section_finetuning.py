"""What 500 episodes more from the best model do (paper, IV-B)."""

from collections.abc import Mapping, Sequence

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Kind, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import METHODS, TRACKS, Drive, Evidence, Scope, rate
from zebrat_bullet.report.comparison.numbers import MISSING
from zebrat_bullet.report.comparison.section_evaluation import WORLDS, comparison_blocks
from zebrat_bullet.report.comparison.statistics import LEVEL, Paired, holm, paired_test

_Key = tuple[str, Scope, str]
"""A set, its fine-tuning and the run that drove after it."""
_Drives = Mapping[str, Sequence[Drive]]
_AFTER: Mapping[Scope, str] = {
    "finetuned": "after, at the same rates",
    "cloning": "after, drawn to the actions of its replay, at a tenth of the actor's rate",
}


def finetuning_section(evidence: Evidence) -> Section | None:
    """Return the section; None where nothing of it was driven."""
    after: dict[_Key, _Drives] = {
        (method, scope, run): at
        for method in METHODS
        for scope in _AFTER
        for run, at in evidence.by_run(scope, method, WORLDS).items()
    }
    if not after:
        return None
    methods = [method for method in METHODS if any(method == tuned for tuned, _, _ in after)]
    before = {
        method: _before(evidence, method, [at for (of, _, _), at in after.items() if of == method])
        for method in methods
    }
    tests = {key: _paired(before[key[0]], at) for key, at in after.items() if before[key[0]]}
    p_values = dict(zip(tests, holm([test.p for test in tests.values()]), strict=True))
    rows: list[Row] = []
    for method in methods:
        if at := before[method]:
            rows.append((method, "before", "", "", *_shares(at), *("",) * 3))
        for key in (key for key in after if key[0] == method):
            _, scope, run = key
            who = (method, _AFTER[scope], str(evidence.seed(run)), _own(evidence, run))
            rows.append((*who, *_shares(after[key]), *_changes(key, tests, p_values)))
    said = Text(
        "**The paper** trains each of its sets 500 episodes more from its best model, and evaluates that. **Ours** "
        "goes on from the policy that stands for the set above, with its critic and optimisers, once for each seed, "
        "and keeps it unless its own noise-free evaluations, of 4 episodes, find one that is no worse."
    )
    caption = (
        "Success in %, before and after on the same starts, of the policy that each run keeps; its own evaluations: "
        "the mean of those on the way, and the last. Gained and lost: those of the starts, of all these tracks, from "
        "which only the one after, only the one before leaves; McNemar's exact test, Holm-corrected over the rows "
        f"(below {LEVEL:g}: in colour). Below: of each set the run whose policy its own evaluations rank highest."
    )
    head = ("set", "fine-tuning", "seed", "own evaluations", *WORLDS, "Tracks 1 to 8", "gained", "lost", "p")
    blocks: list[Block] = [
        said,
        Grid(head, tuple(rows), caption),
        *comparison_blocks(evidence, "finetuned", methods, "finetuned"),
    ]
    return Section("After 500 episodes of fine-tuning", tuple(blocks))


def _own(evidence: Evidence, run: str) -> str | Cell:
    """Return success in a run's own noise-free evaluations after it began: their mean, and the last."""
    its = [row for row in evidence.learning if row["run"] == run and row["success"] is not None and row["total_steps"]]
    if not its:
        return "-"
    its.sort(key=lambda row: row["total_steps"])
    mean = sum(row["success"] for row in its) / len(its)
    return Cell(f"{100 * mean:.0f}, {100 * its[-1]['success']:.0f}", "number")


def _before(evidence: Evidence, method: str, after: Sequence[_Drives]) -> dict[str, list[Drive]]:
    """Return the drives of a set before its fine-tuning from those starts that it drove from after it, by place."""
    starts = {drive.start for at in after for of_place in at.values() for drive in of_place}
    drives = {
        place: [drive for drive in evidence.shown("paper", method, place) if drive.start in starts] for place in WORLDS
    }
    return {place: of_place for place, of_place in drives.items() if of_place}


def _shares(at: _Drives) -> tuple[Cell, ...]:
    cells = [Cell(f"{100 * rate(at[place]).share:.0f}", "number") if place in at else MISSING for place in WORLDS]
    if not all(place in at for place in TRACKS):
        return (*cells, MISSING)
    return (*cells, Cell(f"{rate([drive for place in TRACKS for drive in at[place]])}"))


def _paired(before: _Drives, after: _Drives) -> Paired:
    one, other = ([drive for of_place in at.values() for drive in of_place] for at in (after, before))
    return paired_test({d.start: d.success for d in one}, {d.start: d.success for d in other})


def _changes(key: _Key, tests: Mapping[_Key, Paired], p_values: Mapping[_Key, float]) -> tuple[Cell, ...]:
    if key not in tests:
        return (MISSING,) * 3
    test, p = tests[key], p_values[key]
    kind: Kind = "" if p >= LEVEL else "good" if test.better > test.worse else "bad"
    counts = (Cell(str(n), "number") for n in (test.better, test.worse))
    return (*counts, Cell(f"{p:.2g}", kind))
