"""What the paper claims, where it says so, and the rule that decides it."""

from dataclasses import dataclass

from zebrat_bullet.report.comparison.evidence import (
    METHODS,
    OURS,
    REAL,
    RIGHT_ANGLES,
    STRAIGHT_OUT,
    TRACKS,
    UNSEEN,
    VARIANTS,
    Evidence,
    backed_out,
    collided,
    failed,
)
from zebrat_bullet.report.comparison.rules import (
    STEP_S,
    Finding,
    Rule,
    at_paper_only,
    by_budget,
    every,
    fails_there,
    faster,
    fewer,
    leads,
    more,
    mostly_leaves,
    often,
    often_fails,
    without_a_car,
)
from zebrat_bullet.report.comparison.studies import (
    LAST_PART,
    detects_most,
    finds_a_way_out,
    highest_return,
    more_at_radius,
    more_on_sets,
    more_with_a_wrong_pose,
    planner_fails_there,
)

_RIVALS = tuple(name for name in METHODS if name != OURS)
_ABLATIONS = ("RL_FT", "RL_FOT")
_FEATURES = ("track_4", "track_8")
_BIG = ("big_track",)
_ELSEWHERE = "nothing learned there"


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


_DETECTED = (
    "more contacts than FIRect and FIFR, in time and within 1 s; at scale: strictly ahead in more than half of the "
    "margins tried, and of the cases with other numbers of rays; not upheld if behind in more than half of both"
)

CLAIMS = (
    Claim("SR detects the most collisions: walls that give way", "IV-A, Fig. 4c", _DETECTED, detects_most("ghost")),
    Claim("SR detects the most collisions: walls that stop the car", "IV-A, Fig. 4c", _DETECTED, detects_most("solid")),
    Claim(
        "DDPG reaches the highest return",
        "IV-B, training curve",
        f"best return of every 20 episodes, mean over the last {LAST_PART:.0%} of a run; difference of means over "
        "seeds to each other algorithm, upheld if above 0, not upheld if below 0; at scale of runs of at least a "
        "million steps, the longest that have enough seeds",
        highest_return("ddpg"),
    ),
    Claim(
        "RL_FOMT completes the big track",
        "IV-B",
        "most of its runs have a policy that leaves it in most of the drives of their best own evaluation: all of the "
        "share's Wilson interval above half: upheld; below: not upheld; at scale, where nothing learned there: leaves "
        "it more often than not",
        by_budget(finds_a_way_out("ddpg", "fomt"), mostly_leaves(OURS, _BIG)),
    ),
    Claim(
        "... by learned backing up",
        "IV-B",
        "often backs up (5 cm or more in one go) and leaves there",
        at_paper_only(often(OURS, _BIG, backed_out, "backs up and leaves"), _ELSEWHERE),
    ),
    Claim(
        "RL_FOMT has the highest success in most tracks",
        "IV-C, Fig. 6a",
        "highest, alone or shared, in more than 4 of 8 tracks, and no other method as often: upheld; somebody's is "
        "higher in 4 or more: not upheld",
        leads(OURS, _RIVALS, TRACKS, needed=_ABLATIONS),
    ),
    Claim(
        "... with a lower time cost",
        "IV-C",
        "mean gain on the starts that both leave, each rival and track, over all pairs of their runs; at least "
        f"{STEP_S:g} s, a control step, in more than half of the tracks that both leave, against every rival that "
        "leaves any; in just half: undecided",
        faster(OURS, _RIVALS, TRACKS, needed=_ABLATIONS),
    ),
    Claim(
        "RL_FOMT outperforms the classical, IL and WG sets",
        "V",
        "more success than each of DWA, TEB, IL and RL_WG, 8 tracks",
        every(*(more(OURS, name, TRACKS) for name in ("DWA", "TEB", "IL", "RL_WG"))),
    ),
    Claim(
        "RL_FT fails and collides the most of the ablations",
        "IV-C iv, Fig. 6b",
        "fewer ends without contact or success, and fewer collisions, of RL_FOT and of RL_FOMT than of RL_FT, 8 tracks",
        every(
            *(fewer(name, "RL_FT", TRACKS, collided, "collisions") for name in ("RL_FOT", OURS)),
            *(fewer(name, "RL_FT", TRACKS, failed, "fails") for name in ("RL_FOT", OURS)),
        ),
    ),
    Claim(
        "O lowers collisions",
        "IV-C iii, iv; conclusion",
        "fewer collisions of RL_FOT than of RL_FT, 8 tracks",
        fewer("RL_FOT", "RL_FT", TRACKS, collided, "collisions"),
    ),
    Claim(
        "Sets without O collide more (collision-sparse)",
        "IV-C iii",
        "fewer collisions of RL_FOMT than of RL_WG and of RL_FT, 8 tracks",
        every(*(fewer(OURS, name, TRACKS, collided, "collisions") for name in ("RL_WG", "RL_FT"))),
    ),
    Claim(
        "O brings backing up at right angles",
        "IV-C iv",
        "on Tracks 2 and 7, RL_FOT often backs up (5 cm or more in one go) and leaves, and more often than RL_FT",
        every(
            often("RL_FOT", RIGHT_ANGLES, backed_out, "backs up and leaves"),
            more("RL_FOT", "RL_FT", RIGHT_ANGLES, backed_out, "backed up and left"),
        ),
    ),
    Claim(
        "O carries the turns of Track 7",
        "IV-C iv",
        "more success of RL_FOT and of RL_FOMT than of RL_FT",
        every(*(more(name, "RL_FT", ("track_7",)) for name in ("RL_FOT", OURS))),
    ),
    Claim(
        "RL_FT and RL_FOT fail on uneven and curvy tracks (4 and 8)",
        "IV-C iv",
        "both often do not leave Tracks 4 and 8, and more often than the other six",
        every(*(fails_there(name, _FEATURES) for name in _ABLATIONS)),
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
        "often does not leave Tracks 2 and 7, which have right angles, and more often than the other six; at scale by "
        "each fairer setting, decided where all agree",
        planner_fails_there("DWA", RIGHT_ANGLES),
    ),
    Claim("TEB often fails at 90 degrees", "IV-C i", "as for DWA", planner_fails_there("TEB", RIGHT_ANGLES)),
    Claim("TEB outperforms DWA", "IV-C i", "more success of TEB than of DWA, 8 tracks", more("TEB", "DWA", TRACKS)),
    Claim(
        "Planners collide more at radius 0.3 than at 0.5",
        "IV-B",
        "more collisions of DWA and TEB together; fairer: each other setting by itself, decided where all agree",
        more_at_radius("0.3", "0.5", collided, "collisions"),
    ),
    Claim(
        "Planners fail more at radius 0.5 than at 0.3",
        "IV-B",
        "as above, ends without contact or success",
        more_at_radius("0.5", "0.3", failed, "fails"),
    ),
    Claim(
        "IL is hard to validate in the big track that it was shown",
        "IV-C ii",
        "often does not leave it",
        at_paper_only(often_fails("IL", _BIG), "of the larger sets of pairs none is from there"),
    ),
    Claim(
        "IL does not generalise",
        "IV-C ii",
        "often does not leave Tracks 4 to 8, which it was not shown, and more often than Tracks 1 to 3, which it was "
        "(at scale it was shown none of them); beside it RL_FOMT, which decides nothing",
        fails_there("IL", UNSEEN, beside=(OURS,)),
    ),
    Claim(
        "RL_WG hardly masters 90 degrees",
        "IV-C iii",
        "often does not leave Tracks 2 and 7, and more often than the other six; beside it RL_FOMT, which decides "
        "nothing",
        fails_there("RL_WG", RIGHT_ANGLES, beside=(OURS,)),
    ),
    Claim(
        "RL_FOMT generalises to tracks that it has not seen",
        "I, V",
        "leaves each of Tracks 4 to 8, which no set has learned in, more often than not",
        mostly_leaves(OURS, UNSEEN),
    ),
    Claim(
        "Map-based planners collide where their pose is wrong",
        "abstract, I",
        "more collisions of DWA and TEB together with a pose that is 5 cm and 3 degrees off and drifts than with the "
        "exact one, on the map made before, 8 tracks; beside it a costmap from the live scan, which decides nothing",
        more_with_a_wrong_pose(collided, "collisions"),
    ),
    Claim(
        "RL_FOMT completes the real-world tracks",
        "IV-D",
        "no real car was driven, so nothing is decided; beside it how often it leaves three simulated tracks that are "
        "built after the paper's pictures",
        without_a_car(mostly_leaves(OURS, REAL)),
    ),
)


_ON_SETS = (
    ("M adds success on uneven tracks", "RL_FMT", "RL_FT", ("uneven",), "success"),
    ("M adds success on uneven tracks, beside O", OURS, "RL_FOT", ("uneven",), "success"),
    ("O adds success on uneven tracks", "RL_FOT", "RL_FT", ("uneven",), "success"),
    ("O adds success on uneven tracks, beside M", OURS, "RL_FMT", ("uneven",), "success"),
    ("O lowers collisions", "RL_FT", "RL_FOT", STRAIGHT_OUT, "collision"),
    ("O lowers collisions, beside M", "RL_FMT", OURS, STRAIGHT_OUT, "collision"),
)
N_HARDER = len(_ON_SETS) * len(VARIANTS)
HARDER = tuple(
    Claim(
        said,
        f"`{sets[0]}`" if len(sets) == 1 else "eight sets without reversals",
        VARIANTS[variant] or "a contact costs 50, as printed",
        more_on_sets(a, b, sets, outcome, variant, N_HARDER),
    )
    for variant in VARIANTS
    for said, a, b, sets, outcome in _ON_SETS
)
"""What the paper claims of O and M, asked again where there is more to fail at than in its tracks."""
