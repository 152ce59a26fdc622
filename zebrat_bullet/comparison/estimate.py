"""What a budget will run, how long that takes on this machine, and what will be missing: said before it starts."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from math import ceil

from zebrat_bullet.comparison.cells import cells
from zebrat_bullet.comparison.gather import reached
from zebrat_bullet.comparison.measure import A_SET, CONTACT, START, at_once, driver_kind, track_kind, training_kind
from zebrat_bullet.comparison.policies import Place
from zebrat_bullet.comparison.steps import Collisions, Judge, Step, Train
from zebrat_bullet.processes import usable_cores
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import runs_of

_STEPS_AN_EPISODE = 250
"""Of a training in PyBullet of which nothing is kept."""
_LONG = {"big_track": 3.5}
"""How much longer than in track_2, where it is measured, an episode in a world is; in the others about the same."""


def forecast(place: Place, planned: Sequence[Step], to_do: Sequence[Step], speed: Mapping[str, float]) -> str:
    """Return in words what will be run, how long it takes, and what will be missing.

    Args:
        place: manifest, budget and folder.
        planned, to_do: all steps, and those that are not done.
        speed: what `measure` found; what is not in it is left out of the sum, and said.
    """
    hours: dict[str, float] = defaultdict(float)
    unknown: set[str] = set()
    counts: dict[str, int] = defaultdict(int)
    for step in to_do:
        group = _group(step)
        counts[group] += 1
        seconds = _seconds(place, step, speed)
        if seconds is None:
            unknown.add(group)
        else:
            hours[group] += seconds / 3600
    lines = [f"budget {place.budget}: {place.plan.about}; {len(to_do)} of {len(planned)} steps are to do"]
    lines += [
        f"  {group}: {n} {'step' if n == 1 else 'steps'}, "
        + (f"about {_time(hours[group])}" + (", and what was not measured" if group in unknown else ""))
        for group, n in counts.items()
    ]
    cores = usable_cores()
    if to_do:
        lines.append(f"in all about {_time(sum(hours.values()))} on the {cores} cores here, as fast as they are now")
    if missing := _missing(place):
        lines.append("missing at this budget, and marked in every table: " + "; ".join(missing))
    return "\n".join(lines)


def _group(step: Step) -> str:
    if isinstance(step, Train):
        return f"training {step.training}"
    return f"judging {step.cell.judgement}" if isinstance(step, Judge) else "collision study"


def _seconds(place: Place, step: Step, speed: Mapping[str, float]) -> float | None:
    cores = usable_cores()
    if isinstance(step, Collisions):
        return None if CONTACT not in speed else speed[CONTACT] * step.what.events
    if isinstance(step, Judge):
        kind = driver_kind(step)
        if kind not in speed:
            return None
        driving = speed[kind] if kind == A_SET else speed[kind] * _LONG.get(step.cell.place, 1.0) * step.cell.episodes
        return ((0.0 if kind == A_SET else speed.get(START, 0.0)) + driving) / cores
    assert isinstance(step, Train)
    configs = runs_of(step.sweep, step.folder)
    each: list[float] = []
    side_by_side = 1
    for run in step.missing():
        config = configs[run]
        rate = speed.get(training_kind(config))
        if rate is None:
            return None
        done = reached(run, config).get("steps", 0)
        side_by_side = at_once(config)
        drawing = _drawing(config, speed) * side_by_side / cores
        each.append(max(_steps(place, step.training, config) - done, 0) / rate + drawing)
    return max(sum(each) / side_by_side, *each, 0.0) + speed.get(START, 0.0) * ceil(len(each) / side_by_side)


def _drawing(config: TrainConfig, speed: Mapping[str, float]) -> float:
    """Return the seconds of one core that a run draws its tracks for."""
    return config.planar.n_tracks * speed.get(track_kind(config), 0.0) if config.planar else 0.0


def _steps(place: Place, training: str, config: TrainConfig) -> float:
    """Return how many steps a run will take: as it says, or as many an episode as kept runs of the training took."""
    if config.planar is not None:
        return float(config.steps or 0)
    runs = place.readable_runs(training)
    kept = [reached(readable, config) for run, readable in runs.items() if readable != run]
    episodes, steps = (sum(at.get(name) or 0 for at in kept) for name in ("episodes", "steps"))
    an_episode = steps / episodes if episodes else _STEPS_AN_EPISODE
    return config.episodes * min(an_episode, config.task.episode.max_steps)


def _missing(place: Place) -> list[str]:
    manifest, plan = place.manifest, place.plan
    said = []
    seeds = max(len(budget.seeds) for budget in manifest.budgets.values())
    if len(plan.seeds) < seeds:
        said.append(f"{len(plan.seeds)} of {seeds} seeds of what is trained here")
    cut = [name for name, settings in plan.trainings.items() if settings]
    if cut:
        said.append(f"trained for a moment only: {', '.join(cut)}")
    ever_trained = {name for budget in manifest.budgets.values() for name in budget.trainings}
    absent = [
        f"{name} ({'only what is kept' if training.kept else 'not trained'})"
        for name, training in manifest.trainings.items()
        if name in ever_trained and name not in plan.trainings
    ]
    if absent:
        said.append(f"trainings {', '.join(absent)}")
    wanted, driven = cells(manifest), cells(manifest, place.budget)
    n_wanted, n_driven = (sum(cell.episodes for cell in some) for some in (wanted, driven))
    if len(driven) < len(wanted) or n_driven < n_wanted:
        said.append(f"{len(wanted) - len(driven)} of {len(wanted)} judged cells, and episodes in those that are left")
    return said


def _time(hours: float) -> str:
    if hours < 0.1:
        return f"{hours * 60:.1f} min"
    return f"{hours * 60:.0f} min" if hours < 2 else f"{hours:.1f} h" if hours < 48 else f"{hours / 24:.1f} days"
