"""The watchdog: a run that does not learn says so, names how, and shows the episode.

After every noise-free evaluation it looks at the evaluation's records and at the critic. What it can name is
`COLLAPSES`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.training.collapses import EPISODE_SIGNS, WatchdogConfig, frozen_critic, mostly_fails, one_action

WATCHDOG_COLUMNS = ("episode", "name", "in_a_row", "measured")


@dataclass(frozen=True)
class CriticProbe:
    """What the critic says now of a sample of observations that stays the same all through the run.

    Attributes:
        values: (n,) Q(s, a) or V(s), in units of the reward that the learner sees; n at least 2. Another n than last
            time is another sample, with which nothing is compared.
    """

    values: NDArray[np.floating]

    def __post_init__(self) -> None:
        if self.values.ndim != 1 or len(self.values) < 2 or not np.isfinite(self.values).all():
            raise ConfigError(
                f"a critic probe is a row of at least 2 finite values, got {self.values}; give one value an observation"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """A collapse that one evaluation shows.

    Attributes:
        name: which of `COLLAPSES`.
        measured: what was measured, in words and numbers.
        record: the first episode that shows it.
        in_a_row: evaluations in a row that showed it, this one included.
    """

    name: str
    measured: str
    record: EpisodeRecord
    in_a_row: int

    def row(self, episode: int) -> dict[str, object]:
        """Return the row of `watchdog.csv`; `episode` is the training episode that the evaluation followed."""
        return {"episode": episode, "name": self.name, "in_a_row": self.in_a_row, "measured": self.measured}


class Watchdog:
    """Examines evaluation after evaluation and remembers what it saw.

    Args:
        config: what counts as a collapse.
        state: what `state` returned when the run was saved; None for a new run.
    """

    def __init__(self, config: WatchdogConfig, state: Mapping[str, Any] | None = None) -> None:
        self._config = config
        self._in_a_row: dict[str, int] = dict(state["in_a_row"]) if state else {}
        self._critic = np.array(state["critic"]) if state and state["critic"] else None
        self._confirmed: Finding | None = None

    @property
    def confirmed(self) -> Finding | None:
        """The first collapse, in the order of `COLLAPSES`, that has lasted for `patience` evaluations, if any.

        None before `min_share` of the run, and while fewer than `most` of the episodes fail: where the policy drives
        out, a critic that stands still has nothing left to learn.
        """
        return self._confirmed

    def state(self) -> dict[str, Any]:
        """Return all that is remembered, as JSON values."""
        return {"in_a_row": self._in_a_row, "critic": None if self._critic is None else self._critic.tolist()}

    def examine(self, records: Sequence[EpisodeRecord], critic: CriticProbe | None, share: float) -> list[Finding]:
        """Return the collapses that an evaluation shows, in the order of `COLLAPSES`.

        Args:
            records: the evaluation's episodes, at least one; those of worlds that can be loaded again first, for a
                finding carries the first record that shows it.
            critic: the critic's values; None where there is no critic.
            share: of the run that is over, 0 to 1.
        """
        shown = self._shown(records, critic)
        self._in_a_row = {name: self._in_a_row.get(name, 0) + 1 for name in shown}
        findings = [
            Finding(name=name, measured=measured, record=record, in_a_row=self._in_a_row[name])
            for name, (measured, record) in shown.items()
        ]
        ripe = share >= self._config.min_share and mostly_fails(records, self._config)
        lasting = [finding for finding in findings if finding.in_a_row >= self._config.patience]
        self._confirmed = lasting[0] if ripe and lasting else None
        return findings

    def _shown(
        self, records: Sequence[EpisodeRecord], critic: CriticProbe | None
    ) -> dict[str, tuple[str, EpisodeRecord]]:
        """Return what was measured, and the record that shows it, of each collapse seen."""
        before, self._critic = self._critic, None if critic is None else critic.values.astype(np.float64)
        failed = next((record for record in records if record.outcome != "success"), records[0])
        shown = {}
        if self._critic is not None and (measured := frozen_critic(self._critic, before, self._config)):
            shown["frozen_critic"] = measured, failed
        if measured := one_action(records, self._config):
            shown["one_action"] = measured, failed
        for name, sign in EPISODE_SIGNS.items():
            signs = [(measured, record) for record in records if (measured := sign(record, self._config))]
            if signs and len(signs) >= self._config.most * len(records):
                measured, record = signs[0]
                which = f"{len(signs)} of {len(records)} episodes, as {record.world} {record.episode}"
                shown[name] = f"{which}: {measured}", record
        return shown
