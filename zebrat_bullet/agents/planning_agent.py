"""What planners share as agents: a car whose planner has no way stands."""

import warnings
from abc import ABC, abstractmethod

from zebrat_bullet.errors import PlanError
from zebrat_bullet.notes import Note
from zebrat_bullet.types import Command, Reading


class PlanningAgent(ABC):
    """An agent that plans from the start of an episode; where it finds no plan its car stands, the first time noted."""

    name: str
    _noted = _stands = False

    def reset(self, seed: int) -> None:
        """Begin an episode: planners draw no random numbers."""
        self._stands = False

    def act(self, reading: Reading) -> Command:
        """Return the planner's command, and a stop for the rest of an episode that begins without a plan."""
        if not self._stands:
            try:
                return self._drive(reading)
            except PlanError as error:
                self._stands = True
                if not self._noted:
                    said = f"{self.name} stands where an episode begins without a plan; the first: {error}"
                    warnings.warn(said, Note, stacklevel=2)
                    self._noted = True
        return Command(0.0, 0.0)

    @abstractmethod
    def _drive(self, reading: Reading) -> Command:
        """Return a command.

        Raises:
            PlanError: no way leads from the start of the episode to the goal.
        """
