"""Rules for what is not driven in tracks: the collision study, the training curves, the dilation radius."""

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from zebrat_bullet.report.comparison.evidence import TRACKS, Drive, Evidence, Scope, rate
from zebrat_bullet.report.comparison.rules import (
    NOT_DRIVEN,
    Finding,
    Rule,
    Verdict,
    decide,
    fails_there,
    is_often,
    of_difference,
    shared_why,
    weakest,
)
from zebrat_bullet.report.comparison.statistics import ENOUGH_SEEDS, LEVEL, Rate, rate_difference, seeds_difference

PLANNERS = ("DWA", "TEB")
REPRESENTATIONS = {"sr": "SR", "firect": "FIRect", "fifr": "FIFR"}
COUNTED = {"detected": "in time", "within_1_s": "within 1 s"}
LAST_PART = 0.1
"""Of a training run, whose best returns say what it has come to."""
AT_SCALE_STEPS = 1_000_000
"""The shortest run that says something of what more training changes; those of 1,000 episodes take far fewer."""


def base_cases(evidence: Evidence, walls: str) -> dict[str, dict[str, Any]]:
    """Return the row of each representation with the paper's rays and no margin; of some walls."""
    rows = (row for row in evidence.collisions if row["panel"] == "base" and row["walls"] == walls)
    return {row["representation"]: row for row in rows}


def detects_most(walls: str) -> Rule:
    """Return the rule that the safety region detects the most contacts with walls that let a car pass, or stop it.

    At the paper's budget in time and within 1 s, with the paper's rays and no margin; beyond it by how many of all
    settings tried (numbers of rays, margins) have it ahead.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        if scope == "scale":
            return _ahead_in_settings(evidence, walls)
        cases = base_cases(evidence, walls)
        if not set(REPRESENTATIONS) <= set(cases):
            return NOT_DRIVEN
        findings = []
        for count, word in COUNTED.items():
            rates = {kind: Rate(cases[kind][count], cases[kind]["events"]) for kind in REPRESENTATIONS}
            numbers = ", ".join(
                f"{label} {rates[kind].k}" + ("" if kind == "sr" else _against(rates[kind].k, rates["sr"].k))
                for kind, label in REPRESENTATIONS.items()
            )
            said = f"{word}, of {rates['sr'].n} contacts: {numbers}"
            findings += [
                Finding(of_difference(rate_difference(rates["sr"], rates[kind])), said) for kind in ("firect", "fifr")
            ]
        return weakest(findings)

    return rule


def _against(count: int, of_sr: int) -> str:
    return f" ({count / of_sr - 1.0:+.0%})" if of_sr else ""


def _ahead_in_settings(evidence: Evidence, walls: str) -> Finding:
    """Decide by margins and by numbers of rays apart: how finely either was stepped is no evidence."""
    panels: dict[str, dict[tuple[Any, ...], dict[str, int]]] = defaultdict(lambda: defaultdict(dict))
    for row in evidence.collisions:
        if row["walls"] == walls and row["panel"] != "base":
            panels[row["panel"]][row["setting"], row["margin_m"]][row["representation"]] = row["detected"]
    verdicts, said = set[Verdict](), list[str]()
    for panel, settings in sorted(panels.items()):
        whole = [counts for counts in settings.values() if set(REPRESENTATIONS) <= set(counts)]
        by = [counts["sr"] - max(counts["firect"], counts["fifr"]) for counts in whole]
        if by:
            ahead, behind = sum(n > 0 for n in by), sum(n < 0 for n in by)
            most = Verdict.UPHELD if 2 * ahead > len(by) else Verdict.NOT_UPHELD
            verdicts.add(most if 2 * max(ahead, behind) > len(by) else Verdict.UNDECIDED)
            said.append(f"{panel}: ahead in {ahead}, level in {len(by) - ahead - behind}, behind in {behind}")
    if not said:
        return NOT_DRIVEN
    verdict = verdicts.pop() if len(verdicts) == 1 else Verdict.UNDECIDED
    return Finding(verdict, f"in the settings of each panel of the study, on the same contacts: {'; '.join(said)}")


def last_returns(
    evidence: Evidence, study: str, reward: str, least_steps: int = 0
) -> tuple[str, dict[str, list[float]]]:
    """Return a length and, by algorithm, a value a seed: the mean of the best returns in the last tenth of its blocks.

    Only of completed runs, of no shorter ones, and of one length: the longest of which every algorithm has enough
    seeds; if there is none, the longest.
    """
    runs = [r for r in evidence.runs if (r["study"], r["reward"], r["variant"] or "") == (study, reward, "")]
    runs = [run for run in runs if run["state"] == "complete" and (run["steps"] or 0) >= least_steps]
    blocks: dict[str, list[tuple[int, float]]] = defaultdict(list)
    for row in evidence.learning:
        if row["best_return"] is not None:
            blocks[row["run"]].append((row["total_steps"] or 0, row["best_return"]))
    steps: dict[str, int] = defaultdict(int)
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        if of_run := sorted(blocks[run["run"]]):
            last = [value for _, value in of_run[-max(1, round(LAST_PART * len(of_run))) :]]
            found[run["asked"]][run["algorithm"]].append(sum(last) / len(last))
            steps[run["asked"]] = max(steps[run["asked"]], run["steps"] or 0)
    algorithms = {run["algorithm"] for run in runs}
    enough = [asked for asked, of in found.items() if all(len(of.get(name, ())) >= ENOUGH_SEEDS for name in algorithms)]
    longest = max(enough or found, key=lambda asked: steps[asked], default="")
    return longest, dict(found[longest])


def highest_return(algorithm: str) -> Rule:
    """Return the rule that an algorithm's training curve ends highest under F O M T."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        study, least_steps = ("paper", 0) if scope == "paper" else ("paper-at-scale", AT_SCALE_STEPS)
        asked, found = last_returns(evidence, study, "fomt", least_steps)
        if not found:
            return NOT_DRIVEN
        rivals = sorted(set(found) - {algorithm})
        means = {name: sum(values) / len(values) for name, values in found.items()}
        said = "; ".join(
            f"{n.upper()} {means[n]:.0f} ({len(found[n])} seeds)" for n in sorted(means, key=lambda n: -means[n])
        )
        said = f"after {asked}: {said}" if asked else said
        if algorithm not in found or not rivals:
            return Finding(Verdict.UNDECIDED, said)
        if min(len(values) for values in found.values()) < ENOUGH_SEEDS:
            return Finding(Verdict.UNDECIDED, f"{said}: fewer than {ENOUGH_SEEDS} seeds")
        differences = {name: seeds_difference(found[algorithm], found[name]) for name in rivals}
        verdict = weakest([Finding(of_difference(at, 0.0), "") for at in differences.values()]).verdict
        apart = ", ".join(
            f"{n.upper()} {at.value:+.0f}" if math.isnan(at.low) else f"{n.upper()} {at.low:+.0f} to {at.high:+.0f}"
            for n, at in differences.items()
        )
        return Finding(verdict, f"{said}. {algorithm.upper()} above: {apart}")

    return rule


def finds_a_way_out(algorithm: str, reward: str) -> Rule:
    """Return the rule that most runs at the paper's budget have a policy that leaves the track they learn in.

    By their own noise-free evaluations of it, so of all runs, also those whose policies were not kept.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        keys = ("study", "algorithm", "reward", "variant", "state")
        of_set = ("paper", algorithm, reward, "", "complete")
        runs = [run for run in evidence.runs if tuple(run[key] or "" for key in keys) == of_set]
        if not runs:
            return NOT_DRIVEN
        at = Rate(sum((run["best_success"] or 0.0) > 0.5 for run in runs), len(runs))
        low, high = at.interval
        verdict = Verdict.UPHELD if low > 0.5 else Verdict.NOT_UPHELD if high < 0.5 else Verdict.UNDECIDED
        seeds = len({run["seed"] for run in runs})
        of = f" ({len(runs)} runs of {seeds} seeds)" if seeds < len(runs) else ""
        return Finding(verdict, f"{at} runs have a policy that leaves in most of the drives of its best evaluation{of}")

    return rule


def more_on_sets(
    a: str, b: str, families: Sequence[str], outcome: str = "success", variant: str = "", n_together: int = 1
) -> Rule:
    """Return the rule that episodes of method `a` on held-out sets end so oftener than those of `b`, over runs.

    What makes the difference helps: `a` has it if they end in success, else `b`. Decided by an interval that holds
    together with those of `n_together` such rules (Bonferroni).
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        x, y = (evidence.on_sets(name, families, outcome, variant) for name in (a, b))
        if not x or not y:
            return NOT_DRIVEN
        said = "; ".join(f"{n} {sum(v) / len(v):.0%} (mean of {len(v)} runs)" for n, v in ((a, x), (b, y)))
        if min(len(x), len(y)) < ENOUGH_SEEDS:
            return Finding(Verdict.UNDECIDED, f"{outcome}: {said}: fewer than {ENOUGH_SEEDS} seeds")
        together = seeds_difference(x, y, LEVEL / n_together)
        room = 1.0 - sum(y) / len(y) if outcome == "success" else sum(x) / len(x)
        said = f"{outcome}: {said}; {seeds_difference(x, y)}"
        return decide(
            together,
            room,
            said
            if n_together == 1
            else f"{said}; all {n_together} together {100 * together.low:+.1f} to {100 * together.high:+.1f}",
        )

    return rule


def more_at_radius(radius: str, other: str, what: Callable[[Drive], bool], word: str) -> Rule:
    """Return the rule that drives of map-based planners end so, which is bad, oftener with one dilation radius.

    Each setting is compared with itself at the other radius, its planners in all tracks together, which at the paper's
    budget are both; decided is what all settings agree on.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        findings = []
        for setting, has in _planner_settings(evidence, scope).items():
            pair = [[drive for drive in has if f"inflation_radius_m={r}" in drive.agent] for r in (radius, other)]
            methods = {drive.method for drive in has}
            whole = all(len({(drive.method, drive.place) for drive in of}) == len(methods) * len(TRACKS) for of in pair)
            if whole and (scope != "paper" or len(methods) == len(PLANNERS)):
                one, two = (rate(of, what) for of in pair)
                said = f"{word}{f' ({setting})' if setting else ''}: {radius} m {one}; {other} m {two}"
                findings.append(decide(rate_difference(one, two), 1.0 - two.share, said))
        return agreed(findings)

    return rule


def planner_fails_there(method: str, places: Sequence[str]) -> Rule:
    """Return the rule that a planner often fails in some of Tracks 1 to 8, and oftener than in the others.

    At the paper's budget in its better setting; beyond it by each fairer setting, decided where all agree.
    """
    others = [place for place in TRACKS if place not in places]

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        if scope == "paper":
            return fails_there(method, places)(evidence, scope)
        settings: dict[str, list[Drive]] = defaultdict(list)
        for place in TRACKS:
            for drive in evidence.drives_of(scope, method, place):
                settings[", ".join(filter(None, (drive.setting, drive.noise)))].append(drive)
        findings = []
        for setting, drives in sorted(settings.items()):
            here, there = ([drive for drive in drives if drive.place in of] for of in (places, others))
            if {drive.place for drive in drives} == set(TRACKS):
                at, other = (rate(of, lambda drive: not drive.success) for of in (here, there))
                said = f"{setting}: does not leave {at.share:.0%}, elsewhere {other.share:.0%}"
                contrast = decide(rate_difference(at, other), 1.0 - other.share, said)
                findings.append(weakest([Finding(is_often(at.interval), said), contrast]))
        return agreed(findings)

    return rule


def agreed(findings: Sequence[Finding]) -> Finding:
    """Return what several settings agree on; what they do not is undecided."""
    if not findings:
        return NOT_DRIVEN
    said = ". ".join(each.evidence for each in findings)
    if len({each.verdict for each in findings}) > 1:
        return Finding(Verdict.UNDECIDED, said)
    return Finding(findings[0].verdict, said, shared_why(findings))


def more_with_a_wrong_pose(what: Callable[[Drive], bool], word: str) -> Rule:
    """Return the rule that drives of planners end so oftener where their pose is wrong, on the map made before.

    DWA and TEB together over Tracks 1 to 8, each setting against itself with an exact pose; beside it stand those with
    a costmap from the live scan.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        if scope == "paper":
            return Finding(Verdict.UNDECIDED, "map and pose are exact there", "not asked")
        by_setting: dict[str, dict[tuple[str, ...], dict[bool, list[Drive]]]] = defaultdict(
            lambda: defaultdict(lambda: defaultdict(list))
        )
        for drive in evidence.drives:
            known = not drive.noise or drive.noise.startswith("pose ")
            if known and drive.method in PLANNERS and drive.sim == "bullet" and drive.place in TRACKS:
                beside = [part for part in drive.setting.split(", ") if not part.startswith("radius")]
                key = drive.method, drive.place, drive.setting
                by_setting[", ".join(beside)][key][bool(drive.noise)].append(drive)
        found: dict[str, Finding] = {}
        for setting, by_key in sorted(by_setting.items()):
            both = {key: by for key, by in by_key.items() if len(by) == 2}
            if len({key[:2] for key in both}) == len(PLANNERS) * len(TRACKS):
                one, two = (rate([d for by in both.values() for d in by[wrong]], what) for wrong in (True, False))
                said = f"{word} ({setting or 'map made before'}): wrong pose {one}; exact {two}"
                found[setting] = decide(rate_difference(one, two), 1.0 - two.share, said)
        if "" not in found:
            return NOT_DRIVEN
        return Finding(found[""].verdict, ". ".join(each.evidence for each in found.values()), found[""].why)

    return rule


def _planner_settings(evidence: Evidence, scope: Scope) -> dict[str, list[Drive]]:
    """Return the drives of DWA and TEB by what their setting says beside the radius."""
    found: dict[str, list[Drive]] = defaultdict(list)
    for method in PLANNERS:
        for place in TRACKS:
            for drive in evidence.drives_of(scope, method, place):
                beside = [part for part in drive.setting.split(", ") if not part.startswith("radius")]
                found[", ".join(filter(None, (*beside, drive.noise)))].append(drive)
    return found
