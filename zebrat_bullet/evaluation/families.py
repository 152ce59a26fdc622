"""How policies do on tracks of each family: what generalises from what."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.endings import as_policy, planar_endings
from zebrat_bullet.evaluation.generated import TracksScore, tracks_score
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import FAMILIES, HELD_OUT_SEED, check_family, generate_tracks


@dataclass(frozen=True, kw_only=True)
class FamilyScore:
    """How a policy did on the held-out tracks of a family.

    Attributes:
        score: success, overall and on the worst tenth of the tracks.
        reversals: mean number of times that the commanded speed changed its sign, over the successes; None without any.
    """

    score: TracksScore
    reversals: float | None

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON, without what came of each track."""
        plain = asdict(self.score) | {"reversals": self.reversals}
        del plain["by_track"]
        return plain


def judge_families(
    agents: Sequence[str],
    task: TaskConfig,
    *,
    families: Sequence[str] = FAMILIES,
    tracks: int = 100,
    starts: int = 4,
    seed: int = 0,
    workers: int = 1,
    on_family: Callable[[str, int], None] = lambda family, done: None,
) -> dict[str, dict[str, FamilyScore]]:
    """Drive policies out of the same held-out tracks of each family, on planar cars.

    Args:
        agents: policies: names, files or run folders.
        task: what is judged; limits, lidar and safety region are those that each policy was trained with.
        families: whose tracks, of the seeds from `HELD_OUT_SEED` on.
        tracks, starts: of each family, and episodes in each.
        seed: of noise and dynamics, where they are drawn.
        workers: processes that draw the tracks.
        on_family: called with a family and how many were done before it.

    Returns:
        By agent and family.

    Raises:
        ConfigError: there is no such family, or there are no tracks or starts.
        PolicyError: an agent is no policy; nothing was driven then.
    """
    for family in families:
        check_family(family, None)
    if tracks < 1:
        raise ConfigError(f"name at least 1 track of each family, got {tracks}")
    own = {agent: as_trained(task, agent, own_robot=False)[0] for agent in agents}
    policies = {agent: as_policy(load_agent(agent, own[agent]), agent) for agent in agents}
    robot, seeds = load_robot(task.robot), range(HELD_OUT_SEED, HELD_OUT_SEED + tracks)
    scores: dict[str, dict[str, FamilyScore]] = {agent: {} for agent in agents}
    for done, family in enumerate(families):
        on_family(family, done)
        worlds = list(generate_tracks(seeds, family=family, robot=robot, workers=workers))
        for agent, policy in policies.items():
            endings = planar_endings(policy, own[agent], worlds, starts, seed=seed)
            often = endings.n_reversals[endings.success]
            mean = round(float(often.mean()), 3) if len(often) else None
            scores[agent][family] = FamilyScore(score=tracks_score(endings), reversals=mean)
    return scores
