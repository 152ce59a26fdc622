"""What the manifest asks for beside what the tables have: cells that nobody drove, and how a cell was driven."""

from collections import defaultdict
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
    """

    cells: tuple[Cell, ...]
    missing: tuple[Cell, ...]


def asked_runs(manifest: Manifest) -> dict[tuple[str, ...], int]:
    """Return how many seeds of each set the largest budget trains: by study, algorithm, reward, variant and length."""
    seeds = max((len(budget.seeds) for budget in manifest.budgets.values()), default=0)
    return {
        (training.study, algo, reward, training.variant, training.asked): seeds
        for training in manifest.trainings.values()
        for algo in training.algos
        for reward in training.rewards
    }


def asked_for(manifest: Manifest, evidence: Evidence) -> dict[tuple[str, str, str, str, str], Asked]:
    """Return what was to be driven, by study, method, setting, noise and simulator."""
    keys = ("study", "method", "setting", "noise", "sim", "place")
    driven: dict[tuple[object, ...], set[int | None]] = defaultdict(set)
    for row in (*evidence.held_out, *({k: getattr(d, k) for k in (*keys, "run")} for d in evidence.drives)):
        driven[tuple(row[key] for key in keys)].add(evidence.seed(row["run"]))
    found: dict[tuple[str, str, str, str, str], list[Cell]] = defaultdict(list)
    for cell in cells(manifest):
        found[cell.study, cell.method, cell.setting, cell.noise, cell.sim].append(cell)
    return {
        key: Asked(tuple(of_key), tuple(cell for cell in of_key if not _driven(cell, driven)))
        for key, of_key in found.items()
    }


def _driven(cell: Cell, driven: dict[tuple[object, ...], set[int | None]]) -> bool:
    seeds = driven.get((cell.study, cell.method, cell.setting, cell.noise, cell.sim, cell.place), set())
    return bool(seeds) if cell.seed is None else cell.seed in seeds


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
