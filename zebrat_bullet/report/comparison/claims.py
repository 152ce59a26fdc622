"""What the paper claims, where it says so, and the rule that decides it."""

from dataclasses import dataclass

from zebrat_bullet.report.comparison.evidence import (
    METHODS,
    OURS,
    RIGHT_ANGLES,
    TRACKS,
    UNSEEN,
    Evidence,
    backed_up,
    collided,
    failed,
)
from zebrat_bullet.report.comparison.rules import Finding, Rule, every, faster, leads, more, often_fails
from zebrat_bullet.report.comparison.studies import (
    LAST_PART,
    collides_more_at,
    detects_most,
    highest_return,
    more_on_sets,
)

_RIVALS = tuple(name for name in METHODS if name != OURS)
_FEATURES = ("track_4", "track_8")


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the paper's.

    Attributes:
        said: what is claimed.
        place: where the paper says so.
        how: what the rule compares, in words.
        rule: decides it.
    """

    said: str
    place: str
    how: str
    rule: Rule

    def findings(self, evidence: Evidence) -> tuple[Finding, Finding]:
        """Return what is found at the paper's budget, and at ours."""
        return self.rule(evidence, "paper"), self.rule(evidence, "scale")


CLAIMS = (
    Claim(
        "SR detects the most collisions",
        "IV-A, Fig. 4c",
        "more contacts than FIRect and FIFR, in time and within 1 s, walls that do not stop the car; at scale: ahead "
        "in more than half of all settings (Wilson)",
        detects_most,
    ),
    Claim(
        "DDPG reaches the highest return",
        "IV-B, training curve",
        f"best return of every 20 episodes, mean over the last {LAST_PART:.0%} of a run; difference of interquartile "
        "means over seeds to each other algorithm, upheld if above 0, not upheld if below 0",
        highest_return("ddpg"),
    ),
    Claim(
        "RL_FOMT has the highest success in most tracks",
        "IV-C, Fig. 6a",
        "highest, alone or shared, in more than 4 of 8 tracks: upheld; beaten in at least 4 (paired test, Holm): not "
        "upheld",
        leads(OURS, _RIVALS, TRACKS, needed=("RL_FT", "RL_FOT")),
    ),
    Claim(
        "... with a lower time cost",
        "IV-C",
        "mean time of successes, all pairs of rival and track; faster in more than half (Wilson)",
        faster(OURS, _RIVALS, TRACKS),
    ),
    Claim(
        "RL_FT fails and collides the most of the ablations",
        "IV-C iv, Fig. 6b",
        "more failures without contact, and more collisions, than RL_FOT and than RL_FOMT, 8 tracks",
        every(
            *(more("RL_FT", name, TRACKS, collided, "collisions") for name in ("RL_FOT", OURS)),
            *(more("RL_FT", name, TRACKS, failed, "fails") for name in ("RL_FOT", OURS)),
        ),
    ),
    Claim(
        "O lowers collisions",
        "IV-C iii, iv; conclusion",
        "more collisions of RL_FT than of RL_FOT, 8 tracks",
        more("RL_FT", "RL_FOT", TRACKS, collided, "collisions"),
    ),
    Claim(
        "O brings backing up, and with it Track 7",
        "IV-C iv",
        "on the right angles of Tracks 2 and 7, more episodes of RL_FOT than of RL_FT that reverse and succeed; and "
        "more success on Track 7",
        every(
            more("RL_FOT", "RL_FT", RIGHT_ANGLES, backed_up, "reversed and left"),
            more("RL_FOT", "RL_FT", ("track_7",), word="Track 7"),
        ),
    ),
    Claim(
        "M carries uneven and curvy tracks (4 and 8)",
        "IV-C iv",
        "more success of RL_FOMT than of RL_FOT and than of RL_FT, Tracks 4 and 8",
        every(*(more(OURS, name, _FEATURES) for name in ("RL_FOT", "RL_FT"))),
    ),
    Claim(
        "DWA often fails at 90 degrees",
        "IV-C i",
        "fails often on Tracks 2 and 7; fairer: the best of all other settings in each track",
        often_fails("DWA", RIGHT_ANGLES),
    ),
    Claim("TEB often fails at 90 degrees", "IV-C i", "as for DWA", often_fails("TEB", RIGHT_ANGLES)),
    Claim("TEB outperforms DWA", "IV-C i", "more success of TEB than of DWA, 8 tracks", more("TEB", "DWA", TRACKS)),
    Claim(
        "Planners collide more at radius 0.3 than at 0.5",
        "IV-B",
        "more collisions of DWA and TEB together; fairer: each other setting by itself, decided where all agree",
        collides_more_at("0.3", "0.5"),
    ),
    Claim(
        "IL does not generalise",
        "IV-C ii",
        "fails often on Tracks 4 to 8, which it was not shown; fairer: the best of all other imitators in each track",
        often_fails("IL", UNSEEN),
    ),
    Claim(
        "RL_WG hardly masters 90 degrees",
        "IV-C iii",
        "fails often on Tracks 2 and 7",
        often_fails("RL_WG", RIGHT_ANGLES),
    ),
)

_STRAIGHT_OUT = ("corridors", "corners", "uturns", "curves", "uneven", "bottlenecks", "boxes", "niches")
HARDER = (
    Claim(
        "M carries uneven tracks",
        "held-out set `uneven`",
        "more success of RL_FMT than of RL_FT, and of RL_FOMT than of RL_FOT",
        every(*(more_on_sets(a, b, ("uneven",)) for a, b in (("RL_FMT", "RL_FT"), (OURS, "RL_FOT")))),
    ),
    Claim(
        "O carries uneven tracks as well",
        "held-out set `uneven`",
        "more success of RL_FOT than of RL_FT, and of RL_FOMT than of RL_FMT",
        every(*(more_on_sets(a, b, ("uneven",)) for a, b in (("RL_FOT", "RL_FT"), (OURS, "RL_FMT")))),
    ),
    Claim(
        "O lowers collisions",
        "the eight held-out sets without reversals",
        "more collisions of RL_FT than of RL_FOT, and of RL_FMT than of RL_FOMT",
        every(
            *(more_on_sets(a, b, _STRAIGHT_OUT, "collision") for a, b in (("RL_FT", "RL_FOT"), ("RL_FMT", OURS))),
        ),
    ),
)
"""What the paper claims of O and M, asked again where there is more to fail at than in its tracks."""
