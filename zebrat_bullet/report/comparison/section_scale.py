"""At scale: the sets over their seeds, on the tracks and on the held-out sets; longer runs; fairer rivals."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Picture, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import TRACKS, Drive, Evidence, collided, failed, rate
from zebrat_bullet.report.comparison.figures import draw_intervals, draw_seed_lines
from zebrat_bullet.report.comparison.rules import mean_time_s
from zebrat_bullet.report.comparison.section_evaluation import ABLATION, comparison_blocks
from zebrat_bullet.report.learning_stats import estimates

_MISSING = Cell("not driven", "missing")
_MOST_REVERSALS = 6
_POLICIES = (*ABLATION, "shipped", "allround")


def scale_section(evidence: Evidence) -> Section:
    """Return the section on what holds after many times the paper's training."""
    said = Text(
        "**The paper** trains 1,000 episodes, about 100,000 steps, in one world. **Ours**: planar cars in generated "
        "tracks, at least 10 million steps a run; judged in PyBullet with the 3D lidar on the paper's tracks, which "
        "these runs have never seen, and as planar cars on held-out tracks."
    )
    parts = (
        Section("In the paper's tracks, at scale", tuple(comparison_blocks(evidence, "scale", _POLICIES, "scale"))),
        Section("Over seeds", tuple(_over_seeds(evidence))),
        Section("By family", tuple(_held_out(evidence, "family"))),
        Section("By certified reversals", tuple(_held_out(evidence, "reversals"))),
        Section("The paper's algorithms, longer", tuple(_longer(evidence))),
    )
    return Section("At scale", (said,), parts)


def rivals_section(evidence: Evidence) -> Section:
    """Return the section on every setting of the rivals that are not trained here."""
    said = Text(
        "**The paper** gives DWA and TEB a premade map and tells nothing of an error in it or in the pose; it reports "
        "more collisions at a dilation radius of 0.3 and more failures at 0.5. **Ours**: the paper's settings, and "
        "beside them whatever else was driven: tuned ones, a costmap from the live scan, a pose with error."
    )
    found: dict[tuple[str, str], dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
    for drive in evidence.drives:
        if drive.study == "rivals" and drive.sim == "bullet" and drive.place in TRACKS:
            setting = ", ".join(filter(None, (drive.setting, drive.noise)))
            found[drive.method, setting][drive.place].append(drive)
    if not found:
        return Section("Rivals", (said, Text("*Not driven at this budget.*")))
    rows: list[Row] = []
    for (method, setting), places in sorted(found.items()):
        drives = [drive for of_place in places.values() for drive in of_place]
        shares = (rate(drives), rate(drives, failed), rate(drives, collided))
        time_s = mean_time_s(drives)
        numbers = (str(len(drives)), str(shares[0]), *(f"{each.share:.0%}" for each in shares[1:]), _seconds(time_s))
        track = [_share(places.get(place)) for place in TRACKS]
        rows.append((method, setting or "-", *(Cell(text, "number") for text in numbers), *track))
    head = ("method", "setting", "episodes", "success (95 %)", "fail", "collision", "time, s", *TRACKS)
    return Section("Rivals", (said, Grid(head, tuple(rows), "Success by track in the last eight columns.")))


def _seconds(time_s: float | None) -> str:
    return "-" if time_s is None else f"{time_s:.1f}"


def _share(drives: Sequence[Drive] | None) -> Cell:
    return Cell(f"{100 * rate(drives).share:.0f} %", "number") if drives else _MISSING


def _label(evidence: Evidence, method: str, run: str | None) -> str:
    return " ".join(filter(None, (method, evidence.variant(run))))


def _over_seeds(evidence: Evidence) -> list[Block]:
    """Return success on Tracks 1 to 8 of every run at scale, by set and variant."""
    of_run: dict[tuple[str, str], dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
    for drive in evidence.drives:
        if drive.study == "scale" and drive.run is not None and drive.sim == "bullet" and drive.place in TRACKS:
            of_run[_label(evidence, drive.method, drive.run), drive.run][drive.place].append(drive)
    values: dict[str, list[float]] = defaultdict(list)
    for (label, _), places in sorted(of_run.items()):
        if len(places) == len(TRACKS):
            values[label].append(sum(rate(drives).share for drives in places.values()) / len(TRACKS))
    if not values:
        return [Text("*Not driven at this budget.*")]
    rows, table = {}, []
    for label, each in values.items():
        at = estimates(each)
        low, high = at["iqm_ci"] or (at["iqm"], at["iqm"])
        rows[label] = (at["iqm"], low, high, each)
        interval = "one seed" if len(each) < 2 else f"{low:.1%} to {high:.1%}"
        table.append((label, str(len(each)), f"{at['iqm']:.1%}", interval, f"{min(each):.1%}", f"{max(each):.1%}"))
    caption = "Success on Tracks 1 to 8: interquartile mean (dot), its 95 % bootstrap interval over seeds, each seed."
    drawn = draw_intervals(rows, "success on Tracks 1 to 8")
    head = ("set", "seeds", "interquartile mean", "95 % interval", "least", "greatest")
    return [Picture("scale_seeds", drawn, "Success over seeds at scale", caption), Grid(head, tuple(table))]


def _held_out(evidence: Evidence, column: str) -> list[Block]:
    """Return success on the held-out sets: a row a set of runs, a column a family or number of reversals."""
    shares = _shares(evidence, column, lambda row: row["outcome"] == "success")
    if not shares:
        return [Text("*Not driven at this budget.*")]
    grid = _grid(shares, f"Success by {column}: mean over seeds, and in brackets from the least to the greatest.")
    if column == "family":
        return [grid]
    plain: Mapping[str, Any] = {label: shares[label] for label in _POLICIES if label in shares} or shares
    backing = _grid(
        _shares(evidence, column, lambda row: row["backed_up"]),
        "Episodes in which the car reversed at least once, by the reversals of the certificate: under 0 it need not. "
        "Mean over seeds, and in brackets from the least to the greatest.",
    )
    drawn = draw_seed_lines(plain, "reversals of the certificate")
    return [Picture("held_out_reversals", drawn, grid.caption), grid, backing]


_Shares = dict[str, dict[str, list[float]]]
"""A share a run, by set of runs and by group."""


def _shares(evidence: Evidence, column: str, what: Callable[[Mapping[str, Any]], bool]) -> _Shares:
    """Return which share of a run's episodes on held-out sets is so."""
    counts: dict[str, dict[str, dict[str, list[int]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(lambda: [0, 0]))
    )
    for row in evidence.held_out:
        if row["study"] not in ("scale", "rivals") or row["noise"] or row[column] is None:
            continue
        label = _label(evidence, row["method"], row["run"])
        if row["run"] is None and row["setting"]:  # of what is not trained here each setting is another driver
            label += f", {row['setting']}"
        at = counts[label][_group(row[column])][row["run"] or ""]
        at[0] += row["n"] if what(row) else 0
        at[1] += row["n"]
    return {
        label: {group: [k / n for k, n in of_run.values()] for group, of_run in sorted(of_group.items())}
        for label, of_group in sorted(counts.items())
    }


def _grid(shares: _Shares, caption: str) -> Grid:
    groups = sorted({group for of_label in shares.values() for group in of_label})
    return Grid(
        ("set", *groups),
        tuple((label, *(_seeds_cell(of_label.get(group)) for group in groups)) for label, of_label in shares.items()),
        caption,
    )


def _group(value: str | int) -> str:
    return value if isinstance(value, str) else str(value) if value < _MOST_REVERSALS else f"{_MOST_REVERSALS}+"


def _seeds_cell(shares: Sequence[float] | None) -> Cell:
    if not shares:
        return _MISSING
    said = f"{100 * sum(shares) / len(shares):.0f} %"
    return Cell(said + (f" ({100 * min(shares):.0f}-{100 * max(shares):.0f})" if len(shares) > 1 else ""), "number")


def _longer(evidence: Evidence) -> list[Block]:
    """Return what DDPG and SAC reach at each length: in their own evaluations, and on the tracks."""
    runs: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    lengths: dict[str, int] = {}
    for run in evidence.runs:
        if run["study"] == "paper-at-scale":
            runs[run["algorithm"], run["reward"]][run["asked"] or ""].append(run)
            lengths[run["asked"] or ""] = max(lengths.get(run["asked"] or "", 0), run["steps"] or 0)
    if not runs:
        return [Text("*Not driven at this budget.*")]
    tracks: dict[str | None, list[Drive]] = defaultdict(list)
    for drive in evidence.drives:
        if drive.study == "paper-at-scale" and drive.place in TRACKS:
            tracks[drive.run].append(drive)
    rows: list[Row] = []
    for (algorithm, reward), of_length in sorted(runs.items()):
        for asked in sorted(of_length, key=lambda asked: (lengths[asked], asked)):
            at = [run["best_success"] for run in of_length[asked] if run["best_success"] is not None]
            judged = [drive for run in of_length[asked] for drive in tracks[run["run"]]]
            done = sum(run["state"] == "complete" for run in of_length[asked])
            name = f"{algorithm.upper()} {reward.upper()}"
            rows.append((name, asked, f"{done} of {len(of_length[asked])}", _seeds_cell(at), _share(judged)))
    head = ("set", "asked for", "seeds complete", "success in own evaluations", "Tracks 1-8, best seed")
    caption = "Own evaluations: best policy of a run, mean over seeds and in brackets least to greatest."
    return [Grid(head, tuple(rows), caption)]
