"""Schedules that end with the run, however its length is given: in episodes, or in environment steps."""


class RunBudget:
    """Mixin for SB3 algorithms, before them in the list of bases: what they schedule falls over the run."""

    n_episodes = 1
    n_steps_of_run: int | None = None
    _episode_num: int
    _current_progress_remaining: float

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        done = self._episode_num / self.n_episodes
        if self.n_steps_of_run is not None:
            done = max(done, num_timesteps / self.n_steps_of_run)
        self._current_progress_remaining = max(0.0, 1.0 - done)
