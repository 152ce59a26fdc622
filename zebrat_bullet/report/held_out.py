"""Scores on a held-out set as Markdown tables."""

from collections.abc import Callable, Mapping

from zebrat_bullet.evaluation.held_out import Group, SetScore


def set_table(scores: Mapping[str, SetScore]) -> str:
    """Return a table of the whole set and, below, by difficulty and by what the certificate says.

    Every rate of success stands with its 95 % interval.
    """
    first = next(iter(scores.values()))
    simulator = {"bullet": "PyBullet", "mujoco": "MuJoCo"}.get(first.sim, "planar cars")
    title = f"{first.set} ({first.sha256[:12]}), {first.overall.tracks} tracks x {first.overall.starts}, {simulator}"
    rows = [
        "| agent | success | worst tenth of the tracks | time over the least possible | causes of the rest |",
        "|---|---|---|---|---|",
    ]
    for agent, at in scores.items():
        causes = ", ".join(f"{n} {cause}" for cause, n in at.overall.causes.items() if n and cause != "success") or "-"
        over = "-" if at.over_least is None else f"{at.over_least:.2f}"
        whole = _rate(at.overall.success, at.overall.success_ci)
        worst = _rate(at.overall.worst_tenth, at.overall.worst_tenth_ci)
        rows.append(f"| {agent} | {whole} | {worst} | {over} | {causes} |")
    reversals = {agent: at.by_reversals for agent, at in scores.items()}
    tables = [
        _by_group("difficulty", {agent: at.by_difficulty for agent, at in scores.items()}, _success),
        _by_group("reversals of the certificate", reversals, _success),
        _by_group("the same; the car itself backed up in", reversals, lambda group: f"{group.backing:.1%}"),
        _by_group("clearance of the certificate", {agent: at.by_clearance for agent, at in scores.items()}, _success),
    ]
    return "\n\n".join([title, "\n".join(rows), *tables])


def _by_group(what: str, groups: Mapping[str, Mapping[str, Group]], cell: Callable[[Group], str]) -> str:
    rows = [f"| {what} | tracks | {' | '.join(groups)} |", "|---" * (len(groups) + 2) + "|"]
    for name, group in next(iter(groups.values())).items():
        cells = [cell(of_agent[name]) for of_agent in groups.values()]
        rows.append(f"| {name} | {group.tracks} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _success(group: Group) -> str:
    return _rate(group.success, group.success_ci)


def _rate(share: float, interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{share:.1%} ({low:.1%}-{high:.1%})"
