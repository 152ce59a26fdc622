"""What the manifest asks for beside what the tables have: cells that nobody drove, and how a cell was driven."""

from collections import Counter, defaultdict
from dataclasses import dataclass

from zebrat_bullet.comparison.cells import Cell, cells
from zebrat_bullet.comparison.manifest import Manifest
from zebrat_bullet.report.comparison.evidence import Drive, Evidence


@dataclass(frozen=True, slots=True)
class Asked:
    """Places that a method was to drive in, with a setting, in one study and simulator.

    Attributes:
        cells: of the manifest.
        missing: those of them without an episode.
        n_driven, n_wanted: episodes in those of the cells that are worlds and have any, and how many it was to be.
    """

    cells: tuple[Cell, ...]
    missing: tuple[Cell, ...]
    n_driven: int = 0
    n_wanted: int = 0


def asked_runs(manifest: Manifest) -> dict[tuple[str, ...], int]:
    """Return how many runs of each set the largest budget trains, and keeps of trainings that none has.

    By study, algorithm, reward, variant and length.
    """
    found: dict[tuple[str, ...], int] = defaultdict(int)
    for name, training in manifest.trainings.items():
        budgets = [budget for budget in manifest.budgets.values() if name in budget.trainings]
        seeds = [len(training.seeds_of(budget.seeds)) for budget in budgets]
        for algo in training.algos:
            for reward in training.rewards:
                key = training.study, algo, reward, training.variant, training.asked
                found[key] += max(seeds, default=len(training.kept_seeds))
    return dict(found)


def asked_for(manifest: Manifest, evidence: Evidence) -> dict[tuple[str, str, str, str, str], Asked]:
    """Return what was to be driven, by study, method, setting, noise and simulator."""
    driven: dict[tuple[object, ...], Counter[int | None]] = defaultdict(Counter)
    for drive in evidence.drives:
        driven[key_of(drive)][evidence.seed(drive.run)] += 1
    for row in evidence.held_out:
        key = tuple(row[name] for name in ("study", "method", "setting", "noise", "sim", "place"))
        driven[key][evidence.seed(row["run"])] += row["n"]
    found: dict[tuple[str, str, str, str, str], list[tuple[Cell, int]]] = defaultdict(list)
    for cell in cells(manifest):
        key = cell.study, cell.method, cell.setting, cell.noise, cell.sim
        of_cell = driven[*key, cell.place]
        found[key].append((cell, of_cell.total() if cell.seed is None else of_cell[cell.seed]))
    return {
        key: Asked(
            tuple(cell for cell, _ in of_key),
            tuple(cell for cell, n in of_key if not n),
            sum(n for cell, n in of_key if not cell.is_set),
            sum(cell.episodes for cell, n in of_key if n and not cell.is_set),
        )
        for key, of_key in found.items()
    }


def options_of(manifest: Manifest) -> dict[tuple[str, str, str, str, str, str], tuple[str, ...]]:
    """Return the options that cells were driven under, by study, method, setting, noise, simulator and place."""
    found = {}
    for cell in cells(manifest):
        options = manifest.judgements[cell.judgement].options
        engine = ("--sim", "mujoco") if cell.sim == "mujoco" else ()
        found[cell.study, cell.method, cell.setting, cell.noise, cell.sim, cell.place] = (*engine, *options)
    return found


def key_of(drive: Drive) -> tuple[str, str, str, str, str, str]:
    """Return a drive's key in `options_of`."""
    return drive.study, drive.method, drive.setting, drive.noise, drive.sim, drive.place
