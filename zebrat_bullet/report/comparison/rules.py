"""The rules that decide a claim. They see tables only, and each can say upheld, not upheld or undecided."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from zebrat_bullet.report.comparison.evidence import TRACKS, Drive, Evidence, Scope, rate, succeeded
from zebrat_bullet.report.comparison.shares import compare, compare_places, share
from zebrat_bullet.report.comparison.statistics import ENOUGH_SEEDS, LEVEL, Difference, holm, paired_test

MARGIN = 0.05
"""A claim of "more" is denied where the difference is surely smaller than this; and a share nearer than this to 0 or 1
leaves no room for one."""
OFTEN = 0.25
"""Who fails in more than this share of the episodes fails often."""
STEP_S = 0.2
"""Times nearer to one another than a control step count as equal."""
RULE = (
    f"**More** (of two rates): upheld where the whole 95 % interval of the difference is above 0; not upheld where all "
    f"of it is below {MARGIN * 100:.0f} points; else undecided. **No room**: where a set without what is said to help "
    f"already succeeds in more than {1 - MARGIN:.0%} of the episodes, or collides in fewer than {MARGIN:.0%}, nothing "
    f"can be better by {MARGIN * 100:.0f} points, and the claim is undecided; and where something bad is said to "
    f"happen more than elsewhere and happens there in more than {1 - MARGIN:.0%}, too. **Often**: upheld where all of "
    f"the 95 % interval of the share is above {OFTEN:.0%} (a number of ours, the paper has none), not upheld where it "
    "is below. "
    "Where a method has not driven in all of the tracks concerned, nothing is decided that its drives could change."
)


class Verdict(StrEnum):
    """What became of a claim."""

    UPHELD = "upheld"
    NOT_UPHELD = "not upheld"
    UNDECIDED = "undecided"


Why = Literal["", "not driven", "no room", "not asked"]
"""Why a claim is undecided, if not for the width of an interval."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A verdict, and the numbers that it rests on, in inline Markdown."""

    verdict: Verdict
    evidence: str
    why: Why = ""


NOT_DRIVEN = Finding(Verdict.UNDECIDED, "not driven", "not driven")
Rule = Callable[[Evidence, Scope], Finding]


def without(evidence: Evidence, scope: Scope, methods: Sequence[str]) -> Finding:
    """Return the finding where methods have not driven: told apart is what nobody was to train."""
    asked = [name for name in methods if evidence.is_asked(scope, name)]
    said = [f"{' and '.join(asked)} not driven"] if asked else []
    if other := [name for name in methods if name not in asked]:
        said.append(f"{' and '.join(other)} not trained at this budget")
    return Finding(Verdict.UNDECIDED, "; ".join(said), "not driven")


def of_difference(difference: Difference, margin: float = MARGIN) -> Verdict:
    """Return whether something is more, from the interval of a difference."""
    if difference.low > 0.0:
        return Verdict.UPHELD
    return Verdict.NOT_UPHELD if difference.high < margin else Verdict.UNDECIDED


def decide(difference: Difference, room: float, said: str) -> Finding:
    """Return whether something is more, from the interval of a difference and how great it could have been."""
    verdict = of_difference(difference)
    if verdict != Verdict.UPHELD and not difference.high < 0.0 and room <= MARGIN:
        return Finding(Verdict.UNDECIDED, said, "no room")
    return Finding(verdict, said)


def weakest(findings: Sequence[Finding]) -> Finding:
    """Return what holds of all: upheld if all are, not upheld if any is not."""
    verdicts = [each.verdict for each in findings]
    found = next((v for v in (Verdict.NOT_UPHELD, Verdict.UNDECIDED) if v in verdicts), Verdict.UPHELD)
    said = ". ".join(dict.fromkeys(each.evidence for each in findings))
    return Finding(found, said, shared_why([each for each in findings if each.verdict == found]))


def shared_why(findings: Sequence[Finding]) -> Why:
    """Return why findings of one verdict are so: what would have to change first."""
    whys = {each.why for each in findings}
    order: tuple[Why, ...] = ("not driven", "", "no room", "not asked")
    return next((why for why in order if why in whys), "")


def more(
    a: str, b: str, places: Sequence[str], what: Callable[[Drive], bool] = succeeded, word: str = "success"
) -> Rule:
    """Return the rule that drives of method `a` are oftener so than those of `b`: what `a` has helps."""
    return _more(a, b, places, what, word, lambda of_a, of_b: 1.0 - of_b)


def fewer(a: str, b: str, places: Sequence[str], what: Callable[[Drive], bool], word: str) -> Rule:
    """Return the rule that drives of method `a` are less often so than those of `b`: what `a` has helps."""
    return _more(b, a, places, what, word, lambda of_b, of_a: of_b)


def _more(
    a: str,
    b: str,
    places: Sequence[str],
    what: Callable[[Drive], bool],
    word: str,
    room: Callable[[float, float], float],
) -> Rule:
    """Return the rule that drives of method `a` are oftener so; how much room the two shares leave, `room` says."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        compared = compare(evidence, scope, a, b, places, what)
        if compared is None:
            return without(evidence, scope, [name for name in (a, b) if not evidence.pool(scope, name, places)])
        said = f"{word}: {compared.words}; {compared.difference}"
        return decide(compared.difference, room(*compared.shares), said)

    return rule


def every(*rules: Rule) -> Rule:
    """Return the rule that all of some hold."""
    return lambda evidence, scope: weakest([rule(evidence, scope) for rule in rules])


def by_budget(at_paper: Rule, at_scale: Rule) -> Rule:
    """Return the rule that asks one thing at the paper's budget, another at scale."""
    return lambda evidence, scope: (at_paper if scope == "paper" else at_scale)(evidence, scope)


def at_paper_only(rule: Rule, reason: str) -> Rule:
    """Return a rule of the paper's budget, which cannot be asked at scale."""
    not_asked = Finding(Verdict.UNDECIDED, reason, "not asked")
    return lambda evidence, scope: rule(evidence, scope) if scope == "paper" else not_asked


def is_often(interval: tuple[float, float]) -> Verdict:
    """Return whether a share is that of something that happens often, from its interval."""
    low, high = interval
    return Verdict.UPHELD if low > OFTEN else Verdict.NOT_UPHELD if high < OFTEN else Verdict.UNDECIDED


def often(
    method: str, places: Sequence[str], what: Callable[[Drive], bool], word: str, beside: Sequence[str] = ()
) -> Rule:
    """Return the rule that a method's drives in some worlds are often so; `beside` it stand others' shares."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        at = share(evidence, scope, method, places, what)
        if at is None:
            return without(evidence, scope, [method])
        left = [share(evidence, scope, method, [place]) for place in places]
        each = ", ".join(f"{place} {one.value:.0%}" for place, one in zip(places, left, strict=True) if one)
        others = [(name, share(evidence, scope, name, places, what)) for name in beside]
        said = "".join(f"; {name} {word} in {other.words}" for name, other in others if other)
        return Finding(is_often(at.interval), f"{method} {word} in {at.words}; success by track: {each}{said}")

    return rule


def often_fails(method: str, places: Sequence[str]) -> Rule:
    """Return the rule that a method often ends without success in some worlds."""
    return often(method, places, _not_left, "does not leave")


def fails_there(method: str, places: Sequence[str], beside: Sequence[str] = ()) -> Rule:
    """Return the rule that a method often ends without success in some of Tracks 1 to 8, and oftener than elsewhere.

    Else it is not these worlds that it fails at.
    """
    others = [place for place in TRACKS if place not in places]

    def oftener(evidence: Evidence, scope: Scope) -> Finding:
        compared = compare_places(evidence, scope, method, places, others, _not_left)
        if compared is None:
            return without(evidence, scope, [method])
        said = f"{method} does not leave in {compared.words}; {compared.difference}"
        return decide(compared.difference, 1.0 - compared.shares[1], said)

    return every(often(method, places, _not_left, "does not leave", beside), oftener)


def _not_left(drive: Drive) -> bool:
    return not drive.success


def without_a_car(rule: Rule) -> Rule:
    """Return a rule whose numbers stand beside a claim of a real car, which no simulation can decide."""

    def undecided(evidence: Evidence, scope: Scope) -> Finding:
        found = rule(evidence, scope)
        if found.why == "not driven":
            return found
        return Finding(Verdict.UNDECIDED, f"no real car was driven; simulated {found.evidence}", "not asked")

    return undecided


def mostly_leaves(method: str, places: Sequence[str]) -> Rule:
    """Return the rule that a method leaves each of some worlds more often than not."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        findings = []
        for place in places:
            at = share(evidence, scope, method, [place])
            if at is None:
                return without(evidence, scope, [method])
            low, high = at.interval
            verdict = Verdict.UPHELD if low > 0.5 else Verdict.NOT_UPHELD if high < 0.5 else Verdict.UNDECIDED
            findings.append(Finding(verdict, f"{place} {at.words}"))
        return weakest(findings)

    return rule


def leads(method: str, rivals: Sequence[str], places: Sequence[str], needed: Sequence[str] = ()) -> Rule:
    """Return the rule that a method's success is the highest, alone or shared, in most worlds.

    It is denied where somebody's is higher in half of them, which no further rival can change; and says nothing where
    another method can claim the same. At scale only rivals that were driven count, but those `needed` always.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        drives = {(name, at): evidence.shown(scope, name, at) for name in (method, *rivals) for at in places}
        who = list(rivals)
        if scope == "scale":  # what nobody trained at that budget is no gap
            who = [name for name in rivals if name in needed or any(drives[name, at] for at in places)]
        driven = [at for at in places if drives[method, at] and any(drives[name, at] for name in who)]
        if not driven:
            return NOT_DRIVEN
        best = {at: max(_share(drives[name, at]) for name in (method, *who)) for at in driven}
        ahead = {n: [at for at in driven if _share(drives[n, at]) == best[at]] for n in (method, *who)}
        alone = [at for at in ahead[method] if not any(at in ahead[name] for name in who)]
        lost = [at for at in driven if at not in ahead[method]]
        alike = [name for name in who if len(ahead[name]) >= len(ahead[method])]
        missing = sorted({name for name in who for at in places if not drives[name, at]})
        said = f"among {len(who) + 1} methods highest in {len(ahead[method])} of {len(driven)} tracks, alone in "
        said += f"{len(alone)}; beaten in {len(_beaten(method, who, driven, drives))} by a paired test over starts"
        said += "; highest as often or oftener: " if alike else ""
        said += ", ".join(f"{name} in {len(ahead[name])}" for name in alike)
        said += f"; not driven everywhere: {', '.join(missing)}" if missing else ""
        if 2 * len(lost) >= len(places):
            return Finding(Verdict.NOT_UPHELD, said)
        if missing or len(driven) < len(places):
            return Finding(Verdict.UNDECIDED, said, "not driven")
        if alike:
            full = all(best[at] >= 1.0 - MARGIN for at in ahead[method])
            return Finding(Verdict.UNDECIDED, said, "no room" if full else "")
        return Finding(Verdict.UPHELD, said)

    return rule


def _beaten(
    method: str, rivals: Sequence[str], places: Sequence[str], drives: Mapping[tuple[str, str], Sequence[Drive]]
) -> set[str]:
    """Return the worlds in which some rival is better by the paired test, corrected over all rivals and worlds."""
    pairs = [(name, at) for name in rivals for at in places if drives[name, at]]
    tests = [paired_test(*(_by_start(drives[name, at]) for name in (rival, method))) for rival, at in pairs]
    corrected = holm([test.p for test in tests])
    return {
        at for (_, at), test, p in zip(pairs, tests, corrected, strict=True) if test.better > test.worse and p < LEVEL
    }


def faster(method: str, rivals: Sequence[str], places: Sequence[str], needed: Sequence[str] = ()) -> Rule:
    """Return the rule that a method takes less time than each rival in most worlds, from the starts that both leave.

    Of sets whose seeds were judged all runs count, each against each. A rival that never leaves has no time to beat.
    At scale only rivals that were driven count, but those `needed` always.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        if not evidence.pool(scope, method, places):
            return without(evidence, scope, [method])
        own, findings = _policies(evidence, scope, method, places), []
        for name in rivals:
            if scope == "scale" and name not in needed and not any(evidence.shown(scope, name, at) for at in places):
                continue
            if not evidence.pool(scope, name, places):
                findings.append(without(evidence, scope, [name]))
                continue
            theirs = _policies(evidence, scope, name, places)
            if not any(drive.success for at in theirs for drives in at.values() for drive in drives):
                findings.append(Finding(Verdict.UPHELD, f"{name} never leaves"))
                continue
            pairs = {
                place: [_gained_s(one[place], other[place]) for one in own for other in theirs] for place in places
            }
            known = [float(np.mean(both)) for each in pairs.values() if (both := [s for s in each if s is not None])]
            won, lost = sum(s >= STEP_S for s in known), sum(s <= -STEP_S for s in known)
            over = f" ({len(own)} x {len(theirs)} runs)" if len(own) * len(theirs) > 1 else ""
            said = f"than {name} faster in {won}, slower in {lost} of {len(known)} tracks{over}"
            findings.append(Finding(_in_most(won, len(known)), said))
        return weakest(findings) if findings else NOT_DRIVEN

    return rule


def _in_most(won: int, n: int) -> Verdict:
    """Return whether something is so in most of n; in just half of them, which none are too, is undecided."""
    return Verdict.UNDECIDED if 2 * won == n else Verdict.UPHELD if 2 * won > n else Verdict.NOT_UPHELD


def _policies(evidence: Evidence, scope: Scope, method: str, places: Sequence[str]) -> list[dict[str, list[Drive]]]:
    """Return a method's drives by world, a dictionary a run where enough were judged, else of the one shown."""
    runs = evidence.of_seeds(scope, method, places)
    return runs if len(runs) >= ENOUGH_SEEDS else [{at: evidence.shown(scope, method, at) for at in places}]


def _gained_s(one: Sequence[Drive], other: Sequence[Drive]) -> float | None:
    """Return by how much the one is faster, on the mean of the starts that both leave; None where there is none."""
    times = [{drive.start: drive.duration_s for drive in drives if drive.success} for drives in (one, other)]
    both = times[0].keys() & times[1].keys()
    return float(np.mean([times[1][at] - times[0][at] for at in sorted(both, key=str)])) if both else None


def mean_time_s(drives: Sequence[Drive]) -> float | None:
    """Return the mean time of the successes."""
    times = [drive.duration_s for drive in drives if drive.success]
    return sum(times) / len(times) if times else None


def _by_start(drives: Sequence[Drive]) -> dict[object, bool]:
    return {drive.start: drive.success for drive in drives}


def _share(drives: Sequence[Drive]) -> float:
    return rate(drives).share if drives else -1.0
