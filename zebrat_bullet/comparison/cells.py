"""What is judged in a budget: each agent in each place, from the manifest."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from zebrat_bullet.comparison.manifest import Judgement, Manifest, Share


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One place that one agent is to be judged in: what the columns of the same name in `episodes` hold.

    Attributes:
        judgement: its name in the manifest.
        method, setting, study, sim, place, noise: as in the table.
        episodes: wanted in the world, or in each track of the set.
        training: name; "" of drivers.
        algorithm, reward: of the training; "" of drivers.
        seed: of the training's run; None for the best of all, and of drivers.
        agent: of drivers; "" of trainings.
        is_set: the place is a held-out set.
    """

    judgement: str
    method: str
    setting: str
    study: str
    sim: str
    place: str
    noise: str
    episodes: int
    training: str = ""
    algorithm: str = ""
    reward: str = ""
    seed: int | None = None
    agent: str = ""
    is_set: bool = False


def cells(manifest: Manifest, budget: str | None = None) -> list[Cell]:
    """Return what is judged in a budget, or all that the manifest has, with the seeds of the largest budget."""
    plan = manifest.budget(budget) if budget else None
    seeds = plan.seeds if plan else max((b.seeds for b in manifest.budgets.values()), key=len, default=())
    found: list[Cell] = []
    for name, judgement in manifest.judgements.items():
        if plan is None:
            found += _cells(manifest, name, judgement, Share(), seeds, None)
        elif name in plan.judgements:
            found += _cells(manifest, name, judgement, plan.judgements[name], seeds, plan.trainings)
    return found


def _cells(
    manifest: Manifest,
    name: str,
    judgement: Judgement,
    share: Share,
    seeds: tuple[int, ...],
    trained: Mapping[str, Collection[str]] | None,
) -> Iterator[Cell]:
    places = [(world, False) for world in (judgement.worlds if share.worlds is None else share.worlds)]
    places += [(one, True) for one in (judgement.sets if share.sets is None else share.sets)]
    for place, is_set in places:
        where = {"judgement": name, "sim": judgement.sim, "noise": judgement.noise, "place": place, "is_set": is_set}
        where["episodes"] = share.episodes or judgement.episodes
        for driver in judgement.drivers:
            if share.drivers is None or driver.agent in share.drivers:
                who = {"method": driver.method, "setting": driver.setting, "study": driver.study}
                yield Cell(**where, **who, agent=driver.agent)  # type: ignore[arg-type]
        for training_name in judgement.trainings if share.trainings is None else share.trainings:
            training = manifest.trainings[training_name]
            if trained is not None and training_name not in trained and not training.policies:
                continue  # nothing of it can be driven in this budget
            cut_short = bool(trained and trained.get(training_name))
            kept = training.kept_seeds if training.policies and not cut_short else ()
            asked = training.seeds_of(seeds) if trained is None or training_name in trained else ()
            every = sorted({*asked, *kept})
            for algo in training.algos:
                for reward in training.rewards:
                    who = {"method": f"RL_{reward.upper()}", "setting": training.setting(algo), "study": training.study}
                    who |= {"training": training_name, "algorithm": algo, "reward": reward}
                    for seed in every if judgement.seeds == "every" else (None,):
                        yield Cell(**where, **who, seed=seed)  # type: ignore[arg-type]
