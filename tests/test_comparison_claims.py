"""The paper's claims are decided by the tables alone: each rule can say upheld, not upheld and undecided."""

from typing import Any

import pytest
from comparison_tables import counts, episodes, run, tables

from zebrat_bullet.report.comparison.claims import CLAIMS
from zebrat_bullet.report.comparison.evidence import METHODS, TRACKS, Evidence
from zebrat_bullet.report.comparison.rules import Verdict
from zebrat_bullet.report.comparison.section_scale import scale_section
from zebrat_bullet.report.comparison.statistics import (
    Rate,
    holm,
    paired_test,
    rate_difference,
    seeds_difference,
)
from zebrat_bullet.report.comparison.studies import more_on_sets

ALL, NONE, HALF = "s" * 40, "c" * 40, "sc" * 20
CORNERS = ("track_2", "track_7")


def drive(**outcomes: Any) -> list[dict[str, Any]]:
    """Return drives by method in all tracks; a pair of texts is for right angles and for the rest."""
    rows = []
    for method, said in outcomes.items():
        corner, rest = said if isinstance(said, tuple) else (said, said)
        for place in TRACKS:
            rows += episodes(method, place, corner if place in CORNERS else rest)
    return rows


def faster(method: str, duration_s: float) -> list[dict[str, Any]]:
    return [row | {"duration_s": duration_s} for row in drive(**{method: ALL})]


def backed(method: str, n_reversals: int, outcomes: str = ALL) -> list[dict[str, Any]]:
    return [row | {"n_reversals": n_reversals} for row in drive(**{method: outcomes})]


def at_radius(radius: str, outcomes: str, setting: str = "") -> list[dict[str, Any]]:
    agent = {"agent": f"dwa:inflation_radius_m={radius}", "setting": f"{setting}radius {radius}"}
    return [row | agent for row in drive(DWA=outcomes)]


def detected(sr: int, firect: int, fifr: int) -> dict[str, Any]:
    return {"collisions": [counts("sr", sr), counts("firect", firect), counts("fifr", fifr)]}


def returns(**of: float) -> dict[str, Any]:
    runs = [run(f"{algo}{seed}", algo, seed=seed) for algo in of for seed in range(5)]
    learning = [
        {"run": f"{algo}{seed}", "episode": 20 * i, "total_steps": 100 * i, "best_return": value + seed}
        for algo, value in of.items()
        for seed in range(5)
        for i in range(1, 11)
    ]
    return {"runs": runs, "learning": learning}


RIVALS = {name: HALF for name in METHODS if name != "RL_FOMT"}
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "SR detects the most collisions": (detected(900, 700, 600), detected(600, 700, 500)),
    "DDPG reaches the highest return": (returns(ddpg=300, sac=200, dqn=100), returns(ddpg=200, sac=300, dqn=100)),
    "RL_FOMT has the highest success in most tracks": (
        {"episodes": drive(RL_FOMT=ALL, **RIVALS)},
        {"episodes": drive(RL_FOMT=NONE, **RIVALS)},
    ),
    "... with a lower time cost": (
        {"episodes": faster("RL_FOMT", 10.0) + faster("TEB", 20.0)},
        {"episodes": faster("RL_FOMT", 20.0) + faster("TEB", 10.0)},
    ),
    "RL_FT fails and collides the most of the ablations": (
        {"episodes": drive(RL_FT="cf" * 20, RL_FOT=ALL, RL_FOMT=ALL)},
        {"episodes": drive(RL_FT=ALL, RL_FOT=ALL, RL_FOMT=ALL)},
    ),
    "O lowers collisions": (
        {"episodes": drive(RL_FT=NONE, RL_FOT=ALL)},
        {"episodes": drive(RL_FT=ALL, RL_FOT=NONE)},
    ),
    "O brings backing up, and with it Track 7": (
        {"episodes": backed("RL_FOT", 2) + backed("RL_FT", 0, NONE)},
        {"episodes": backed("RL_FOT", 0) + backed("RL_FT", 0)},
    ),
    "M carries uneven and curvy tracks (4 and 8)": (
        {"episodes": drive(RL_FOMT=ALL, RL_FOT=NONE, RL_FT=NONE)},
        {"episodes": drive(RL_FOMT=NONE, RL_FOT=ALL, RL_FT=ALL)},
    ),
    "DWA often fails at 90 degrees": ({"episodes": drive(DWA=(NONE, ALL))}, {"episodes": drive(DWA=ALL)}),
    "TEB often fails at 90 degrees": ({"episodes": drive(TEB=(NONE, ALL))}, {"episodes": drive(TEB=ALL)}),
    "TEB outperforms DWA": ({"episodes": drive(TEB=ALL, DWA=HALF)}, {"episodes": drive(TEB=HALF, DWA=ALL)}),
    "Planners collide more at radius 0.3 than at 0.5": (
        {"episodes": at_radius("0.3", HALF) + at_radius("0.5", ALL)},
        {"episodes": at_radius("0.3", ALL) + at_radius("0.5", HALF)},
    ),
    "IL does not generalise": ({"episodes": drive(IL=NONE)}, {"episodes": drive(IL=ALL)}),
    "RL_WG hardly masters 90 degrees": ({"episodes": drive(RL_WG=(NONE, ALL))}, {"episodes": drive(RL_WG=ALL)}),
}


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.said)
def test_a_rule_can_go_either_way(claim):
    for rows, verdict in zip(CASES[claim.said], (Verdict.UPHELD, Verdict.NOT_UPHELD), strict=True):
        paper, _ = claim.findings(Evidence(tables(**rows)))
        assert paper.verdict == verdict, paper.evidence


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.said)
def test_without_records_nothing_is_decided(claim):
    for finding in claim.findings(Evidence(tables())):
        assert finding.verdict == Verdict.UNDECIDED and not finding.driven and "not driven" in finding.evidence


def test_a_track_that_was_not_driven_leaves_a_claim_undecided():
    rows = [row for row in drive(RL_FT=NONE, RL_FOT=ALL) if row["place"] != "track_5"]
    claim = next(claim for claim in CLAIMS if claim.said == "O lowers collisions")
    assert claim.rule(Evidence(tables(episodes=rows)), "paper").verdict == Verdict.UNDECIDED


def test_each_fairer_setting_of_a_planner_is_compared_with_itself_at_the_other_radius():
    claim = next(claim for claim in CLAIMS if claim.said == "Planners collide more at radius 0.3 than at 0.5")

    def finding(*settings: tuple[str, str, str]) -> tuple[Verdict, int]:
        rows = [row for name, r3, r5 in settings for row in at_radius("0.3", r3, name) + at_radius("0.5", r5, name)]
        said = claim.findings(Evidence(tables(episodes=rows)))[1]
        return said.verdict, said.evidence.count("collisions (")

    tuned, live = ("tuned, ", HALF, ALL), ("tuned, live costmap, ", HALF, ALL)
    assert finding(tuned) == (Verdict.UPHELD, 1)
    assert finding(tuned, live) == (Verdict.UPHELD, 2)
    assert finding(tuned, ("live costmap, ", ALL, HALF)) == (Verdict.UNDECIDED, 2)


def test_the_best_run_of_a_set_stands_for_it_and_the_better_radius_in_each_track():
    runs = [run("bad", best_success=0.2), run("good", best_success=0.9), run("sac", "sac", best_success=1.0)]
    rows = [
        row
        for name, outcomes in (("bad", ALL), ("good", HALF), ("sac", NONE))
        for row in episodes("RL_FOMT", "track_1", outcomes, run=name)
    ]
    rows += [r for r in at_radius("0.3", HALF) + at_radius("0.5", NONE) if r["place"] == "track_1"]
    evidence = Evidence(tables(runs=runs, episodes=rows))
    assert {drive.run for drive in evidence.shown("paper", "RL_FOMT", "track_1")} == {"good"}
    assert {drive.setting for drive in evidence.shown("paper", "DWA", "track_1")} == {"radius 0.3"}


def test_at_scale_sets_are_compared_over_seeds_and_variants_are_left_out():
    runs, rows = [], []
    for reward, share in (("ft", NONE), ("fot", ALL)):
        for seed in range(3):
            name = f"{reward}{seed}"
            runs.append(run(name, "ppo", reward, study="scale", seed=seed))
            for place in TRACKS:
                rows += episodes(f"RL_{reward.upper()}", place, share, study="scale", run=name)
    runs.append(run("crash", "ppo", "ft", study="scale", variant="crash"))
    rows += [row for place in TRACKS for row in episodes("RL_FT", place, ALL, study="scale", run="crash")]
    claim = next(claim for claim in CLAIMS if claim.said == "O lowers collisions")
    found = claim.rule(Evidence(tables(runs=runs, episodes=rows)), "scale")
    assert found.verdict == Verdict.UPHELD and "mean of 3 runs" in found.evidence


def test_newcombes_interval_is_that_of_his_paper():
    """Newcombe 1998, Table II, (a) 56/70 and 48/80, method 10: 0.0524 to 0.3339."""
    at = rate_difference(Rate(56, 70), Rate(48, 80))
    assert (round(at.value, 4), round(at.low, 4), round(at.high, 4)) == (0.2, 0.0524, 0.3339)


def test_mcnemars_test_counts_only_starts_that_both_had():
    one = dict.fromkeys(range(12), True) | {"alone": True}
    other = {i: i < 2 for i in range(12)}
    at = paired_test(one, other)
    assert (at.n, at.better, at.worse) == (12, 10, 0) and at.p == pytest.approx(2 * 0.5**10)


def test_holms_correction_is_the_worked_one():
    """By hand: 0.01 x 4; 0.02 x 3 = 0.06; 0.03 x 2 = 0.06; 0.04 x 1 is less than those before it."""
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])


def test_an_interval_over_seeds_is_the_same_twice_and_none_where_all_agree():
    a, b = [0.9, 0.8, 0.95, 0.85, 0.7], [0.2, 0.3, 0.1, 0.25, 0.4]
    assert seeds_difference(a, b) == seeds_difference(a, b) and seeds_difference(a, b).low > 0.3
    assert seeds_difference([1.0] * 3, [0.5] * 3).low == 0.5


def test_on_held_out_tracks_it_is_counted_who_backs_up_where_nothing_asks_for_it():
    def on_set(reversals: int, n_reversals: list[int]) -> list[dict[str, object]]:
        rows = episodes("shipped", "corners", "s" * len(n_reversals), study="scale", sim="planar", reversals=reversals)
        return [row | {"family": "corners", "n_reversals": n} for row, n in zip(rows, n_reversals, strict=True)]

    drives = [*on_set(2, [2, 2, 0, 3]), *on_set(0, [0, 0, 0, 4, 0])]
    clone = [row | {"method": "IL", "setting": "9 pairs"} for row in on_set(0, [0])]
    made = tables(episodes=[*drives, *clone, *(row | {"setting": "99 pairs"} for row in clone)])
    parts = {part.title: part for part in scale_section(Evidence(made)).parts}
    _, success, backing = parts["By certified reversals"].blocks
    assert success.head == backing.head == ("set", "0", "2")
    assert [row[0] for row in backing.rows] == ["IL, 9 pairs", "IL, 99 pairs", "shipped"]
    assert [cell.text for cell in success.rows[2][1:]] == ["100 %", "100 %"]
    assert [cell.text for cell in backing.rows[2][1:]] == ["20 %", "75 %"]


@pytest.mark.parametrize(
    "m_and_t, t, seeds, verdict",
    [
        ("s" * 8, "sc" * 4, 3, Verdict.UPHELD),
        ("sc" * 4, "s" * 8, 3, Verdict.NOT_UPHELD),
        ("s" * 8, "sc" * 4, 2, Verdict.UNDECIDED),
        ("s" * 8, "", 3, Verdict.UNDECIDED),
    ],
)
def test_a_set_that_does_better_on_held_out_tracks_does_so_over_seeds(m_and_t, t, seeds, verdict):
    def judged(reward: str, outcomes: str, variant: str = "") -> list[dict[str, Any]]:
        names = [f"{variant}{reward}-{seed}" for seed in range(seeds)]
        runs.extend(run(name, "ppo", reward, study="scale", variant=variant) for name in names)
        where = {"study": "scale", "sim": "planar", "family": "uneven", "reversals": 0}
        rows = [episodes(f"RL_{reward.upper()}", "uneven", outcomes, run=name, **where) for name in names]
        return [row for of_run in rows for row in of_run]

    runs: list[dict[str, Any]] = []
    drives = [*judged("fmt", m_and_t), *judged("ft", t), *judged("ft", "s" * 8, "crash")]  # a variant counts for none
    made = Evidence(tables(runs=runs, episodes=drives))
    assert more_on_sets("RL_FMT", "RL_FT", ("uneven",))(made, "scale").verdict is verdict
    assert not more_on_sets("RL_FMT", "RL_FT", ("corners",))(made, "scale").driven
