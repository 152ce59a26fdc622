"""What training runs have reached, in numbers: estimates over seeds, and how far the reward paid for not leaving."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

from zebrat_bullet.report.learning_runs import RunGroup, Table, TrainingRun


def iqm(values: NDArray[np.float64], axis: int = -1) -> Any:
    """Return the interquartile mean (Agarwal et al. 2021): a quarter of the values is cut off at either end.

    Fewer than four values are too few to cut: it is their mean.
    """
    return trim_mean(values, 0.25, axis=axis)


def estimates(values: Sequence[float]) -> dict[str, Any]:
    """Return mean, sd (n - 1) and IQM of one value a seed, with 95 % percentile bootstrap intervals over seeds.

    All are None without a value, sd and intervals None with a single one.
    """
    x = np.array(values, dtype=float)
    made: dict[str, Any] = dict.fromkeys(("mean", "sd", "mean_ci", "iqm", "iqm_ci")) | {"n": len(x)}
    if len(x):
        made |= {"mean": float(x.mean()), "iqm": float(iqm(x))}
    if len(x) > 1:
        made["sd"] = float(x.std(ddof=1))
        for name, statistic in (("mean_ci", np.mean), ("iqm_ci", iqm)):
            interval = bootstrap((x,), statistic, method="percentile", rng=0).confidence_interval
            made[name] = [float(interval.low), float(interval.high)]
    return made


def reward_trap(runs: Sequence[TrainingRun], exit_reward: float) -> dict[str, Any]:
    """Return how far the reward paid cars that did not leave (false exits among them) more than those that did.

    Args:
        runs: of one reward.
        exit_reward: R_r; what an episode earned beyond it came from staying inside.

    Returns:
        `episodes` of training without success; `median_success`, the median return of those with; how many of the
        former earned more than that (`above_median_success`) and more than R_r (`above_exit_reward`); and `largest`,
        the best paid of them: its return, outcome, steps, seed and episode. None where there is nothing to compare.
    """
    success = np.concatenate([run.episodes["outcome"] == "success" for run in runs])
    returns = np.concatenate([run.episodes["return"] for run in runs])
    failed = returns[~success]
    median = float(np.median(returns[success])) if success.any() else None
    return {
        "episodes": len(failed),
        "median_success": median,
        "above_median_success": None if median is None else int((failed > median).sum()),
        "above_exit_reward": int((failed > exit_reward).sum()),
        "largest": _best_paid_failure(runs),
    }


def _best_paid_failure(runs: Sequence[TrainingRun]) -> dict[str, Any] | None:
    found: dict[str, Any] | None = None
    for run in runs:
        at = run.episodes
        if (failed := np.flatnonzero(at["outcome"] != "success")).size:
            i = failed[np.argmax(at["return"][failed])]
            if found is None or at["return"][i] > found["return"]:
                found = {"return": float(at["return"][i]), "outcome": str(at["outcome"][i])}
                found |= {"steps": int(at["steps"][i]), "seed": run.seed, "episode": int(at["episode"][i])}
    return found


def summarise_run(run: TrainingRun) -> dict[str, Any]:
    """Return what a run has reached; None where it has no such thing yet."""
    episodes, judged = run.episodes, run.evaluations
    best = _best(judged)
    at_best = {name: None if best is None else _number(judged[name][best]) for name in ("episode", "success", "time_s")}
    return {
        "folder": str(run.folder),
        "seed": run.seed,
        "finished": run.finished,
        "episodes": len(episodes["return"]),
        "budget": run.budget,
        "budget_unit": run.unit,
        "steps": int(max([*episodes["total_steps"], *judged["total_steps"]], default=0)),
        "wall_s": float(max([*episodes["wall_s"], *judged["wall_s"]], default=0.0)),
        "best_score": float(max(episodes["return"])) if len(episodes["return"]) else None,
        "best_policy": at_best,
        "last_success": float(judged["success"][-1]) if len(judged["success"]) else None,
    }


def _best(judged: Table) -> int | None:
    """Return which evaluation is that of the policy kept: the last of the best."""
    kept = np.flatnonzero(judged["best"] == 1).tolist()
    return kept[-1] if kept else None


def summarise_group(group: RunGroup) -> dict[str, Any]:
    """Return what a group has reached: each run, and estimates over those that have a value."""
    runs = [summarise_run(run) for run in group.runs]
    best = [run["best_policy"] for run in runs]
    succeeded = [at["success"] for at in best if at["success"] is not None]
    return {
        "algo": group.algo,
        "reward": group.reward,
        "variant": group.variant,
        "runs": runs,
        "unfinished": sum(not run["finished"] for run in runs),
        **{name: estimates([run[name] for run in runs]) for name in ("episodes", "steps", "wall_s")},
        "best_score": estimates([run["best_score"] for run in runs if run["best_score"] is not None]),
        "best_success": estimates(succeeded),
        "last_success": estimates([run["last_success"] for run in runs if run["last_success"] is not None]),
        "seeds_that_succeed": sum(value > 0 for value in succeeded),
        "time_s": estimates([at["time_s"] for at in best if at["time_s"] is not None]),
        "reward_trap": reward_trap(group.runs, group.exit_reward),
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
