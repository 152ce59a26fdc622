"""The claims of the paper and what became of each."""

from collections import Counter
from collections.abc import Sequence

from zebrat_bullet.report.comparison.claims import CLAIMS, HARDER, N_HARDER
from zebrat_bullet.report.comparison.document import Cell, Grid, Kind, Section, Text
from zebrat_bullet.report.comparison.evidence import Evidence
from zebrat_bullet.report.comparison.rules import RULE, Finding, Verdict, Why
from zebrat_bullet.report.comparison.statistics import ENOUGH_SEEDS

_KINDS: dict[Verdict, Kind] = {Verdict.UPHELD: "good", Verdict.NOT_UPHELD: "bad", Verdict.UNDECIDED: "open"}
_WHY: dict[Why, str] = {
    "not driven": "not driven",
    "no room": "where there is no room for a difference",
    "not asked": "that cannot be asked there",
}
TITLE = "Claims of the paper"


def claims_section(evidence: Evidence) -> tuple[Section, str]:
    """Return the section, and its sum in a sentence."""
    found = [claim.findings(evidence) for claim in CLAIMS]
    rows = tuple(
        (f"{claim.said} ({claim.place})", *_cells(paper), *_cells(scale))
        for claim, (paper, scale) in zip(CLAIMS, found, strict=True)
    )
    head = ("claim", "paper's budget", "evidence at the paper's budget", "at scale, fairer rivals", "evidence there")
    rules = tuple((claim.said, claim.how) for claim in CLAIMS)
    how = Section(
        "How each claim is decided",
        (
            Text(
                f"{RULE}\n\nWhere at least {ENOUGH_SEEDS} seeds of the sets concerned were judged, a share is the mean "
                "over seeds, with a t-interval, and a difference that of two means, with Welch's (Colas et al. 2019: "
                "with so few seeds a bootstrap is too sure; of seeds that are all alike, as below, over all their "
                "episodes). Else a share is one policy's, with Wilson's interval, and a difference is between one "
                "policy of each, over episodes, with Newcombe's: it speaks of these two policies in these tracks, not "
                "of what another seed would have learned, and starts of one track resemble each other, so that it is "
                "on the narrow side. Where no seed differs from another, the interval over their episodes says nothing "
                "of what a sixth would do. Verdicts are not corrected for being many. The rules are code and see the "
                "tables only, but were written, and some of them mended, when part of the tables could be seen: they "
                "are no preregistration. Sections and figures are numbered as in the version on arXiv."
            ),
            Grid(("claim", "what is compared"), rules, wordy=True),
        ),
        folded=True,
    )
    asked_again = tuple(
        (f"{claim.said} ({claim.place})", claim.how, *_cells(claim.rule(evidence, "scale"))) for claim in HARDER
    )
    harder = Section(
        "O and M on harder tracks",
        (
            Text(
                "Not in the paper, and asked after the first runs had been seen: where every set reaches its ceiling "
                "in the paper's tracks, they cannot tell what O and M are good for. The same runs at scale on held-out "
                f"tracks, over seeds. As these are {N_HARDER} questions of one kind, each is decided by an interval "
                "that holds for all of them together (Bonferroni):"
            ),
            Grid(("claim", "runs", "at scale", "evidence"), asked_again, wordy=True),
        ),
    )
    paper, scale = (_sum(findings) for findings in zip(*found, strict=True))
    lead = f"At the paper's budget: {paper}. At scale and with fairer rivals: {scale}."
    said = Text(
        'Each with its evidence and the verdict of a rule: "How each claim is decided", below, has them all. Some rows '
        "ask parts of one sentence of the paper's, or look at the same drives, so their number is no score."
    )
    return Section(TITLE, (said, Grid(head, rows, wordy=True)), (harder, how)), lead


def _cells(finding: Finding) -> tuple[Cell, str]:
    if finding.why:
        kind: Kind = "missing" if finding.why == "not driven" else "open"
        return Cell(f"undecided: {finding.why}", kind), finding.evidence
    return Cell(str(finding.verdict), _KINDS[finding.verdict]), finding.evidence


def _sum(findings: Sequence[Finding]) -> str:
    counts = Counter(finding.verdict for finding in findings)
    whys = Counter[Why](finding.why for finding in findings)
    reasons = ", ".join(f"{whys[why]} {said}" for why, said in _WHY.items() if whys[why])
    said = f"of {len(findings)} claims " + ", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict)
    return said + (f" ({reasons})" if reasons else "")
