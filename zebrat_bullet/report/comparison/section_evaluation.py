"""Success, fails and collisions by method and track, the ablation of O and M, and the paired tests."""

from collections.abc import Mapping, Sequence

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Kind, Picture, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import (
    METHODS,
    OURS,
    REAL,
    TRACKS,
    Drive,
    Evidence,
    Scope,
    backed_out,
    backed_up,
    collided,
    failed,
    rate,
)
from zebrat_bullet.report.comparison.figures import draw_intervals, draw_outcomes
from zebrat_bullet.report.comparison.numbers import MISSING
from zebrat_bullet.report.comparison.rules import mean_time_s
from zebrat_bullet.report.comparison.statistics import LEVEL, Paired, holm, paired_test, sign_flip_test
from zebrat_bullet.report.learning_stats import estimates
from zebrat_bullet.world import load_world

WORLDS = ("big_track", *TRACKS)
_WHEN: Mapping[Scope, str] = {
    "paper": "at the paper's budget",
    "finetuned": "after fine-tuning",
    "cloning": "after fine-tuning that is drawn to its replay",
    "scale": "at scale",
}
ABLATION = ("RL_FT", "RL_FOT", "RL_FMT", "RL_FOMT")
BETTER, WORSE = "▲", "▼"


def evaluation_section(evidence: Evidence) -> Section:
    """Return the section on the paper's evaluation (IV-C) at its own budget."""
    said = Text(
        "**The paper**: seven methods on eight tracks, learned ones 70 episodes each, map-based ones 15 for each "
        "dilation radius, the better radius shown. Its rates by track are only in a picture (Fig. 6a); in its text, "
        "RL_FOMT has the highest success in most tracks with a lower time cost. **Ours**: of the seeds of a set the "
        "policy that does best in its own evaluations drives (of equal ones, as all of RL_FT's are, the first seed's), "
        "before any fine-tuning; of two radii the one that leaves "
        "more often over all tracks. DWA and TEB are given map, pose and goal, RL_WG its waypoints, in tracks that it "
        "has not seen too; IL and the others see their scan alone. The tracks: "
        + "; ".join(f"{place}: {_described(place)}" for place in WORLDS)
        + "."
    )
    blocks: list[Block] = [said, *comparison_blocks(evidence, "paper", METHODS, "evaluation")]
    parts = [_tests(evidence)]
    if real := _real(evidence):
        parts.append(real)
    return Section("Evaluation in the tracks", tuple(blocks), tuple(parts))


def _real(evidence: Evidence) -> Section | None:
    """Return what was driven in the tracks of the paper's real-world test (IV-D)."""
    rows: list[Row] = [
        (name, str(evidence.seed(run)), *(each(at.get(place, ())) for each in (_success, _rest) for place in REAL))
        for name in METHODS
        for run, at in evidence.by_run("paper", name, REAL).items()
    ]
    if not rows:
        return None
    said = Text(
        "**The paper** drives RL_FOMT through three tracks with its real car, known by pictures: all three without a "
        "collision. **Ours**: three simulated tracks after them; no real car was driven; of each seed the policy that "
        "does best in its own evaluations. " + "; ".join(f"{place}: {_described(place)}" for place in REAL) + "."
    )
    head = ("set", "seed", *REAL, *(f"{place}: fails / collisions in %, s" for place in REAL))
    return Section("The real-world tracks, simulated", (said, Grid(head, tuple(rows))))


def _described(place: str) -> str:
    text = load_world(place).description
    return text[:1].lower() + text[1:]


def ablation_section(evidence: Evidence) -> Section:
    """Return the section on the ablation of O and M (paper, Fig. 6b), at both budgets."""
    said = Text(
        "**The paper**: RL_FT has the highest fail and collision rate; O makes RL_FOT collide less and teaches backing "
        "up; only M carries Tracks 4 and 8, where RL_FT and RL_FOT both fail. Its numbers are only in a picture (Fig. "
        "6b). **Ours**: all eight tracks together, of each set the policy that does best in its own evaluations."
    )
    parts = {}
    rows: list[Row] = []
    budgets: tuple[tuple[Scope, str], ...] = (("paper", "the paper's budget"), ("scale", "at scale"))
    for scope, title in budgets:
        parts[title] = {name: evidence.pool(scope, name, TRACKS) for name in ABLATION}
        for name, drives in parts[title].items():
            if evidence.is_asked(scope, name):
                rows.append((title, name, *_ablation_cells(drives)))
    head = ("budget", "set", "episodes", "success (95 %)", "fail", "collision", "backed up and left", "Tracks 4 and 8")
    picture = Picture(
        "ablation", draw_outcomes(parts, 1), "Outcomes of the ablations at both budgets, eight tracks together"
    )
    return Section("Ablation of O and M", (said, picture, Grid(head, tuple(rows))), _every_seed(evidence))


def _every_seed(evidence: Evidence) -> tuple[Section, ...]:
    """Return what each run at the paper's budget does in each track: how much a seed decides; empty without runs."""
    rows: list[Row] = [
        (method, str(evidence.seed(run)), *_seed_cells(places))
        for method in METHODS
        for run, places in evidence.by_run("paper", method, WORLDS).items()
    ]
    if not rows:
        return ()
    said = (
        "Of each run the policy that does best in its own evaluations: success in %; and, of all its drives in Tracks "
        "1 to 8, those that touch and those that back up, 5 cm or more in one go."
    )
    head = ("set", "seed", *WORLDS, "touch", "back up")
    over = {method: of for method in METHODS if (of := evidence.seeds("paper", method, TRACKS))}
    blocks = [Grid(head, tuple(rows), said), *seeds_blocks(over, "paper_seeds", "Success over seeds at this budget")]
    return (Section("Every seed at the paper's budget", tuple(blocks)),)


def seeds_blocks(values: Mapping[str, Sequence[float]], name: str, title: str) -> list[Block]:
    """Return a figure and a table of success on Tracks 1 to 8 over seeds, of each set one value a seed."""
    if not values:
        return []
    rows, table = {}, []
    for label, each in values.items():
        at = estimates(list(each))
        low, high = at["iqm_ci"] or (at["iqm"], at["iqm"])
        rows[label] = (at["iqm"], low, high, list(each))
        interval = "one seed" if len(each) < 2 else f"{low:.1%} to {high:.1%}"
        table.append((label, str(len(each)), f"{at['iqm']:.1%}", interval, f"{min(each):.1%}", f"{max(each):.1%}"))
    caption = (
        "Success on Tracks 1 to 8: interquartile mean (Agarwal et al. 2021, rliable; of fewer than four seeds it is "
        "the mean), its 95 % bootstrap interval over seeds, which is on the narrow side for so few, and each seed."
    )
    drawn = draw_intervals(rows, "success on Tracks 1 to 8")
    head = ("set", "seeds", "interquartile mean", "95 % interval", "least", "greatest")
    return [Picture(name, drawn, title, caption), Grid(head, tuple(table))]


def _seed_cells(at: Mapping[str, Sequence[Drive]]) -> tuple[Cell, ...]:
    cells = [Cell(f"{100 * rate(at[place]).share:.0f}", "number") if place in at else MISSING for place in WORLDS]
    if not all(place in at for place in TRACKS):
        return (*cells, MISSING, MISSING)
    pooled = [drive for place in TRACKS for drive in at[place]]
    return (*cells, *(Cell(f"{rate(pooled, what).share:.0%}", "number") for what in (collided, backed_up)))


def _ablation_cells(drives: Sequence[Drive]) -> tuple[Cell, ...]:
    if not drives:
        return (MISSING,) * 6
    at = rate(drives)
    backed = rate(drives, backed_out)
    features = rate([drive for drive in drives if drive.place in ("track_4", "track_8")])
    shares = (f"{each.share:.0%}" for each in (rate(drives, failed), rate(drives, collided), backed, features))
    return tuple(Cell(text, "number") for text in (str(at.n), _with_interval(drives), *shares))


def comparison_blocks(evidence: Evidence, scope: Scope, methods: Sequence[str], name: str) -> list[Block]:
    """Return a figure of outcomes, a table of success and one of the rest, a row a method and a column a world."""
    drives = {place: {method: evidence.shown(scope, method, place) for method in methods} for place in WORLDS}
    if not any(of for at in drives.values() for of in at.values()):
        return [Text("*Not driven at this budget.*")]
    marks = _marks(evidence, scope, methods)
    tracks = {place: drives[place] for place in TRACKS}
    success: list[Row] = []
    rest: list[Row] = []
    for method in methods:
        label = evidence.label(scope, method)
        success.append((label, *(_success(drives[place][method], marks.get((method, place), "")) for place in WORLDS)))
        rest.append((method, *(_rest(drives[place][method]) for place in WORLDS)))
    head = ("method", *WORLDS)
    numbers = sorted({len(of) for at in drives.values() for of in at.values() if of})
    note = (
        f"Of {' or '.join(map(str, numbers))} episodes each. "
        f"Success with its 95 % Wilson interval. {BETTER} better, {WORSE} worse than RL_FOMT on the same starts: "
        f"McNemar's exact test, Holm-corrected over all methods and tracks of this table, p < {LEVEL:g}."
    )
    alt = f"Success, fails and collisions by method and track, {_WHEN[scope]}"
    return [
        Picture(f"{name}_outcomes", draw_outcomes(tracks), alt),
        Grid(head, tuple(success), note),
        Grid(head, tuple(rest), "Fails / collisions in %, mean time of the successes."),
    ]


def _success(drives: Sequence[Drive], mark: str = "") -> Cell:
    if not drives:
        return MISSING
    kind: Kind = "good" if mark == BETTER else "bad" if mark == WORSE else ""
    return Cell(f"{_with_interval(drives)}{f' {mark}' if mark else ''}", kind)


def _with_interval(drives: Sequence[Drive]) -> str:
    at = rate(drives)
    low, high = at.interval
    return f"**{100 * at.share:.0f} %** {100 * low:.0f}-{100 * high:.0f}"


def _rest(drives: Sequence[Drive]) -> Cell:
    if not drives:
        return MISSING
    time_s = mean_time_s(drives)
    said = f"{100 * rate(drives, failed).share:.0f} / {100 * rate(drives, collided).share:.0f}"
    return Cell(said + (f", {time_s:.1f} s" if time_s is not None else ""))


def _pairs(evidence: Evidence, scope: Scope, method: str, places: Sequence[str]) -> Paired | None:
    one, other = ([d for place in places for d in evidence.shown(scope, name, place)] for name in (method, OURS))
    if not one or not other:
        return None
    return paired_test({d.start: d.success for d in one}, {d.start: d.success for d in other})


def _marks(evidence: Evidence, scope: Scope, methods: Sequence[str]) -> dict[tuple[str, str], str]:
    tests = {}
    for method in methods:
        for place in WORLDS:
            if method != OURS and (test := _pairs(evidence, scope, method, (place,))) and test.n:
                tests[method, place] = test
    corrected = holm([test.p for test in tests.values()])
    marks = {}
    for (key, test), p in zip(tests.items(), corrected, strict=True):
        if p < LEVEL:
            marks[key] = BETTER if test.better > test.worse else WORSE
    return marks


def _tests(evidence: Evidence) -> Section:
    """Return each method against RL_FOMT over all tracks: on the same starts, and over tracks."""
    rows: list[Row] = []
    budgets: tuple[tuple[Scope, str], ...] = (("paper", "the paper's budget"), ("scale", "at scale, fairer rivals"))
    for scope, title in budgets:
        names = [name for name in (*METHODS, "RL_FMT", "shipped", "allround") if name != OURS]
        tests = {name: test for name in names if (test := _pairs(evidence, scope, name, TRACKS)) and test.n}
        apart = {name: _apart(evidence, scope, name) for name in tests}
        over_tracks = {name: sign_flip_test(by) for name, by in apart.items()}
        corrected = [holm([test.p for test in tests.values()]), holm(list(over_tracks.values()))]
        for (name, test), p, p_tracks in zip(tests.items(), *corrected, strict=True):
            higher, lower = sum(by > 0 for by in apart[name]), sum(by < 0 for by in apart[name])
            verdict = "better" if sum(apart[name]) > 0 else "worse"
            if p_tracks >= LEVEL:
                can_tell = len(tests) * 2.0 ** (1 - higher - lower) < LEVEL
                verdict = "no difference shown" if can_tell else "too few tracks differ to tell"
            kind: Kind = "" if p_tracks >= LEVEL else "good" if verdict == "better" else "bad"
            of_starts = str(test.n), str(test.better), str(test.worse), f"{p:.2g}"
            numbers = *of_starts, f"{higher} / {lower}", f"{over_tracks[name]:.2g}", f"{p_tracks:.2g}"
            rows.append((title, name, *(Cell(text, "number") for text in numbers), Cell(verdict, kind)))
    starts = "same starts", "only it leaves", "only RL_FOMT leaves", "p over starts, Holm"
    tracks = "tracks it is higher / lower in", "p over tracks", "p over tracks, Holm"
    head = ("budget", "method", *starts, *tracks, "than RL_FOMT in tracks like these")
    text = Text(
        "Over starts: McNemar's exact test over the starts of Tracks 1 to 8 that both drove. It speaks of these "
        "policies in these very tracks: starts of one track are near one another, and most policies leave it "
        "from all of them or from none. Over tracks: whether one would be better in other tracks like these, an exact "
        "sign-flip test of the differences by track, which where eight tracks differ can be no smaller than 0.008, "
        "where six do than 0.03. Both are corrected over the methods of a budget (Holm): where too few tracks differ, "
        "the smallest p times the number of methods is above 0.05, and nothing could be told. What another seed would "
        "have learned is a question for the "
        "intervals over seeds."
    )
    grid = Grid(head, tuple(rows))
    return Section("Paired tests against RL_FOMT", (text, grid if rows else Text("*Not driven at this budget.*")))


def _apart(evidence: Evidence, scope: Scope, method: str) -> list[float]:
    """Return how much oftener a method leaves than RL_FOMT, by track, of those that both have driven."""
    both = [[evidence.shown(scope, name, place) for name in (method, OURS)] for place in TRACKS]
    return [rate(one).share - rate(other).share for one, other in both if one and other]
