"""The rules that decide a claim. They see tables only, and each can say upheld, not upheld or undecided."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from zebrat_bullet.report.comparison.evidence import Drive, Evidence, Scope, rate, succeeded
from zebrat_bullet.report.comparison.statistics import Difference, Rate, holm, paired_test

MARGIN = 0.05
"""A difference of rates that a claim of "more" is denied to fall short of."""
OFTEN = 0.25
"""Who fails in more than this share of the episodes fails often."""
RULE = (
    f"**More** (of two rates): upheld where the whole 95 % interval of the difference is above 0; not upheld where all "
    f"of it is below {MARGIN * 100:.0f} points; else undecided. **Often fails**: upheld where the whole 95 % interval "
    f"of the failures (whatever ends without success) is above {OFTEN:.0%}, not upheld where it is below. Where a "
    "method has not driven in all of the tracks concerned, nothing is decided."
)


class Verdict(StrEnum):
    """What became of a claim."""

    UPHELD = "upheld"
    NOT_UPHELD = "not upheld"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Finding:
    """A verdict, and the numbers that it rests on, in inline Markdown."""

    verdict: Verdict
    evidence: str
    driven: bool = True


NOT_DRIVEN = Finding(Verdict.UNDECIDED, "not driven", driven=False)
Rule = Callable[[Evidence, Scope], Finding]


def of_difference(difference: Difference, margin: float = MARGIN) -> Verdict:
    """Return whether something is more, from the interval of a difference."""
    if difference.low > 0.0:
        return Verdict.UPHELD
    return Verdict.NOT_UPHELD if difference.high < margin else Verdict.UNDECIDED


def weakest(findings: Sequence[Finding]) -> Finding:
    """Return what holds of all: upheld if all are, not upheld if any is not."""
    verdicts = [each.verdict for each in findings]
    found = next((v for v in (Verdict.NOT_UPHELD, Verdict.UNDECIDED) if v in verdicts), Verdict.UPHELD)
    said = ". ".join(dict.fromkeys(each.evidence for each in findings))
    return Finding(found, said, any(each.driven for each in findings))


def more(
    a: str, b: str, places: Sequence[str], what: Callable[[Drive], bool] = succeeded, word: str = "success"
) -> Rule:
    """Return the rule that drives of method `a` are oftener so than those of `b`."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        compared = evidence.compare(scope, a, b, places, what)
        if compared is None:
            missing = [name for name in (a, b) if not evidence.pool(scope, name, places)]
            return Finding(Verdict.UNDECIDED, f"{' and '.join(missing)} not driven", driven=False)
        at, said = compared
        points = f"{100 * at.value:+.0f} points, {100 * at.low:+.0f} to {100 * at.high:+.0f}"
        return Finding(of_difference(at), f"{word}: {said}; {points}")

    return rule


def every(*rules: Rule) -> Rule:
    """Return the rule that all of some hold."""
    return lambda evidence, scope: weakest([rule(evidence, scope) for rule in rules])


def often_fails(method: str, places: Sequence[str]) -> Rule:
    """Return the rule that a method often ends without success in some worlds."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        pool = evidence.pool(scope, method, places)
        if not pool:
            return NOT_DRIVEN
        failures = rate(pool, lambda drive: not drive.success)
        low, high = failures.interval
        verdict = Verdict.UPHELD if low > OFTEN else Verdict.NOT_UPHELD if high < OFTEN else Verdict.UNDECIDED
        each = ", ".join(f"{place} {rate(evidence.shown(scope, method, place)).share:.0%}" for place in places)
        return Finding(verdict, f"{method} fails in {failures}; success by track: {each}")

    return rule


def leads(method: str, rivals: Sequence[str], places: Sequence[str], needed: Sequence[str] = ()) -> Rule:
    """Return the rule that a method's success is the highest in most worlds.

    A world is for it where nobody's success is higher, and against it where somebody's is by the paired test, corrected
    over all pairs of rival and world. At scale only rivals that were driven count, but those `needed` always.
    """

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        drives = {(name, at): evidence.shown(scope, name, at) for name in (method, *rivals) for at in places}
        who = rivals
        if scope == "scale":  # what nobody trained at that budget is no gap
            who = [name for name in rivals if name in needed or any(drives[name, at] for at in places)]
        pairs = [(name, at) for name in who for at in places if drives[name, at] and drives[method, at]]
        if not pairs:
            return NOT_DRIVEN
        tests = {pair: paired_test(*(_by_start(drives[name, pair[1]]) for name in (pair[0], method))) for pair in pairs}
        corrected = dict(zip(pairs, holm([test.p for test in tests.values()]), strict=True))
        driven = [at for at in places if drives[method, at] and any(drives[name, at] for name in who)]
        first = [at for at in driven if all(_share(drives[name, at]) <= _share(drives[method, at]) for name in who)]
        shared = [at for at in first if any(_share(drives[name, at]) == _share(drives[method, at]) for name in who)]
        beaten = [
            at
            for at in driven
            if any(
                (n, at) in tests and tests[n, at].better > tests[n, at].worse and corrected[n, at] < 0.05 for n in who
            )
        ]
        whole = len(pairs) == len(who) * len(places)
        verdict = Verdict.UNDECIDED
        if whole and len(first) > len(places) / 2:
            verdict = Verdict.UPHELD
        elif whole and len(beaten) >= len(places) / 2:
            verdict = Verdict.NOT_UPHELD
        said = f"among {len(who) + 1} methods highest in {len(first)} of {len(driven)} tracks "
        said += f"({len(shared)} of these shared), beaten in {len(beaten)}"
        missing = sorted({name for name in who for at in places if not drives[name, at]})
        return Finding(verdict, said + (f"; not driven everywhere: {', '.join(missing)}" if missing else ""))

    return rule


def faster(method: str, rivals: Sequence[str], places: Sequence[str]) -> Rule:
    """Return the rule that a method's successes take less time, on the mean, than each rival's in most worlds."""

    def rule(evidence: Evidence, scope: Scope) -> Finding:
        won, compared = 0, 0
        for name in rivals:
            for at in places:
                one, other = (mean_time_s(evidence.shown(scope, each, at)) for each in (method, name))
                if one is not None and other is not None:
                    compared += 1
                    won += one < other
        if not compared:
            return NOT_DRIVEN
        low, high = Rate(won, compared).interval
        verdict = Verdict.UPHELD if low > 0.5 else Verdict.NOT_UPHELD if high < 0.5 else Verdict.UNDECIDED
        return Finding(verdict, f"faster in {Rate(won, compared)} pairs of rival and track in which both succeed")

    return rule


def mean_time_s(drives: Sequence[Drive]) -> float | None:
    """Return the mean time of the successes."""
    times = [drive.duration_s for drive in drives if drive.success]
    return sum(times) / len(times) if times else None


def _by_start(drives: Sequence[Drive]) -> dict[object, bool]:
    return {drive.start: drive.success for drive in drives}


def _share(drives: Sequence[Drive]) -> float:
    return rate(drives).share if drives else -1.0
