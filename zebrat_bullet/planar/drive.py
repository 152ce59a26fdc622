"""One task driven by N planar cars at once: what `task.drive` is for one car in PyBullet, by the same rules."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zebrat_bullet.arrays import Array, like, namespace, on_host
from zebrat_bullet.config import TaskConfig, require_planar_cars
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.asked import chances_of, facts_of, require_actions, require_arrays, require_state_of
from zebrat_bullet.planar.margins import OTHER, Margins, draw_margins, margins_of
from zebrat_bullet.planar.places import places_of, starts_of
from zebrat_bullet.planar.simulation import PlanarSimulation
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.sensing.beams import side_bearings
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.dynamics import draw_dynamics
from zebrat_bullet.task.episode import EpisodeRules, gates_of, open_lines
from zebrat_bullet.task.observation import observation_spec
from zebrat_bullet.task.rewards import RewardInput, check_weights, rewards, weighted_terms
from zebrat_bullet.types import Commands, Pose2
from zebrat_bullet.values import of_kind
from zebrat_bullet.world import World
from zebrat_bullet.world.fingerprint import fingerprint

N_STARTS = 64
"""Start poses drawn for each world; every episode begins at one of them."""


@dataclass(frozen=True, slots=True)
class PlanarStep:
    """What came of one control step of N cars.

    Attributes:
        observation: (N, size) float32; of a car whose episode has ended, the first of its next one.
        reward: (N,).
        terms: each weighted reward term, (N,), by name, also on terminal steps, where they are not paid.
        outcome: (N,) int8, codes of `Outcome`, 0 where the episode goes on.
        ended: (K,) the cars whose episodes have ended, ascending.
        last_observation: (K, size) float32, the last of their episodes.
        last_pose: (K, 3) float64, where these ended, on the host: x, y in m and yaw in rad, world frame.
        world: (K,) the worlds of these episodes, by their place in `worlds`.
        start: (K,) their start poses, by their place in `starts` of that world.
    """

    observation: Array
    reward: Array
    terms: dict[str, Array]
    outcome: Array
    ended: NDArray[np.intp]
    last_observation: Array
    last_pose: NDArray[np.float64]
    world: NDArray[np.int32]
    start: NDArray[np.int32]


class PlanarDrive:
    """N cars under a task; a car whose episode ends begins its next one in the same step.

    Which world and start, which dynamics and which noise an episode gets comes from one generator, in the order of the
    cars, so that the same seed gives the same numbers on the same device, bit for bit.

    Args:
        task: the task; `lidar.caster` does not matter.
        worlds: each episode draws one.
        n_cars: N.
        device: "cpu" or "cuda".
        seed: of worlds, starts, dynamics and noise.
        raw: observations and actions in SI units instead of [-1, 1].
        margin_m: walls so near to the outline count as touched; a policy that learns with it does not shave walls. Of a
            range each episode draws one: where there is room such a policy keeps away, where there is none it squeezes.
            By family of tracks, where some leave less room than others.

    Attributes:
        spec: the observation.
        worlds: those there are; `add_worlds` brings more.
        starts: (W, N_STARTS, 3) float64, the poses at which episodes begin, world frame.
        weights: (W,) chances of the worlds, or None where all are alike. May be set: to numbers in their proportion.
        begun: whether anyone has said since it was made how the episodes begin: by `reset`, `begin_at` or `load`.

    Raises:
        ConfigError: the task is guided or disturbs what planar cars do not have, the device is not there, or its memory
            does not hold the cars.
        WorldError: a world does not fit the plane, or has no place to begin.
    """

    def __init__(
        self,
        task: TaskConfig,
        worlds: Sequence[World],
        n_cars: int,
        *,
        device: str = "cpu",
        seed: int = 0,
        raw: bool = False,
        margin_m: Margins = 0.0,
    ) -> None:
        self._margins_of = margins_of(margin_m)
        of_kind(task, TaskConfig, "task", "PlanarVectorEnv takes a mapping too")
        check_weights(task.reward)
        require_planar_cars(task)
        if not worlds:
            raise ConfigError("worlds is empty; name at least one world")
        task = fitted(task)
        self.task = task
        self.robot = load_robot(task.robot)
        self.region = make_region(self.robot, task.region, task.lidar.n_bearings)
        self.spec = observation_spec(task, self.region, self.robot, raw)
        sides = side_bearings(task.lidar.n_bearings)
        indices, places = np.unique(np.concatenate([self.region.indices, sides]), return_inverse=True)
        self._seen, self._sides = places[:-2], places[-2:]
        self._all_seen = len(indices) == len(self._seen) and bool((np.diff(self._seen) == 1).all())
        self.worlds: list[World] = []
        self._known: list[str] = []
        self.starts = np.empty((0, N_STARTS, 3))
        self._margins = np.empty((0, 2))
        self._weights: NDArray[np.float64] | None = None
        self.sim = PlanarSimulation(self.robot, task, indices, worlds, n_cars, device)
        self.n_cars = n_cars = len(self.sim.pose)
        self._note_worlds(worlds)
        self._rules = EpisodeRules(task.episode, self.robot, self.sim.pose)
        self._trail = self.spec.new_trail(self.sim.command)
        self._n_steps = 0
        self._start = np.zeros(n_cars, dtype=np.int32)
        self._noise_base = np.zeros(n_cars, dtype=np.int32)
        self.reset(seed)
        self.begun = False

    def add_worlds(self, worlds: Sequence[World]) -> None:
        """Let later episodes take place in these worlds too; beside `weights`, each as often as the others' mean."""
        self.sim.add_worlds(worlds)
        self._note_worlds(worlds)
        if self._weights is not None:
            mean = np.full(len(worlds), self._weights.mean())
            self.weights = np.concatenate([self._weights, mean])

    @property
    def weights(self) -> NDArray[np.float64] | None:
        """Chances of the worlds, (W,), or None where all are alike."""
        return self._weights

    @weights.setter
    def weights(self, weights: ArrayLike | None) -> None:
        self._weights = None if weights is None else chances_of(weights, len(self.worlds))

    def poses(self) -> NDArray[np.float64]:
        """Return where the cars stand, on the host: (N, 3) x, y in m and yaw in rad, each in its world's frame."""
        return self._poses(slice(None))

    def _poses(self, cars: NDArray[np.intp] | slice) -> NDArray[np.float64]:
        poses = on_host(self.sim.pose[cars]).astype(np.float64)
        poses[:, :2] += self.sim.origin[on_host(self.sim.world[cars])]
        return poses

    def _note_worlds(self, worlds: Sequence[World]) -> None:
        first = len(self.worlds)
        self.worlds += worlds
        drawn = (starts_of(world, self.robot, self.task.episode, N_STARTS)[None] for world in worlds)
        self.starts = np.concatenate([self.starts, *drawn])
        margins = [self._margins_of.get(world.family, self._margins_of[OTHER]) for world in worlds]
        self._margins = np.concatenate([self._margins, np.array(margins).reshape(-1, 2)])
        lines = open_lines(self.worlds) - self.sim.origin[:, None]
        self._lines = np.concatenate([getattr(self, "_lines", lines[:0]), lines[first:]])
        gates = gates_of(self.worlds)
        self._gates = None if gates is None else gates - self.sim.origin[:, None, None]
        self._max_steps = np.array([world.max_steps or self.task.episode.max_steps for world in self.worlds])

    def reset(self, seed: int | None = None) -> Array:
        """Begin an episode of every car and return the (N, size) observations; None goes on with the same generator."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self._begin(np.arange(self.n_cars))
        self.begun = True
        self.sim.look()
        return self._observe()

    def begin_at(self, worlds: ArrayLike, poses: Sequence[Pose2] | NDArray[np.float64]) -> Array:
        """Begin an episode of every car in a given world and at a given pose; return the (N, size) observations.

        Args:
            worlds: (N,) whole numbers, places in `worlds`.
            poses: N of them, or (N, 3) x, y in m and yaw in rad, world frame.

        Raises:
            ConfigError: not one for each car, there is no such world, or a car would stand in a wall or off the ground.
        """
        return self.begin_unchecked(*places_of(worlds, poses, self.n_cars, self.worlds, self.robot.footprint_base))

    def begin_unchecked(self, worlds: NDArray[np.int32], poses: NDArray[np.float64]) -> Array:
        """Begin as `begin_at` does; in a wall, where a wide start range reaches one, the episode ends at once."""
        self._place(np.arange(self.n_cars), worlds, poses)
        self.begun = True
        self.sim.look()
        return self._observe()

    def step(self, actions: Array) -> PlanarStep:
        """Drive every car one control step.

        Args:
            actions: (N, 2), in [-1, 1] or SI where `raw`; beyond the limits they are clipped.

        Raises:
            ActionError: one is not finite; nothing was simulated.
        """
        require_actions(actions, self.n_cars, self._n_steps + 1)
        return self.follow(self.spec.decode_cars(actions))

    def follow(self, commands: Commands) -> PlanarStep:
        """Drive every car one control step by commands within the limits, in m/s and rad."""
        sim = self.sim
        sim.command[:, 0], sim.command[:, 1] = commands.speed_mps, commands.steering_rad
        sim.step()
        self._trail.follow(sim.command)
        self._n_steps += 1
        sim.draws[:] = like(self._noise_base, sim.draws) + self._n_steps
        sim.look()
        clearance = self.region.clearances(self._obs())
        open_width = sim.ranges[:, int(self._sides[0])] + sim.ranges[:, int(self._sides[1])]
        outcome = self._rules.judge(sim.pose, sim.contact, clearance.collision, open_width)
        speed = sim.motion[:, 2]
        nearer = namespace(speed).zeros_like(speed)
        terms = weighted_terms(RewardInput(clearance, self.region, speed, commands, self.task.reward, nearer))
        reward = rewards(terms, outcome, self.task.reward)
        observation = self._observe()
        ended = np.flatnonzero(on_host(outcome))
        last, last_pose = observation[ended], self._poses(ended)
        world, start = on_host(sim.world[ended]).copy(), self._start[ended]
        if len(ended):
            self._begin(ended)
            sim.look(ended)
            observation[ended] = self._observe()[ended] if len(ended) > self.n_cars // 2 else self._observe(ended)
        return PlanarStep(observation, reward, terms, outcome, ended, last, last_pose, world, start)

    def _begin(self, cars: NDArray[np.intp]) -> None:
        """Draw world, start, dynamics and noise of the next episode of some cars, and stand them there."""
        n, rng = len(cars), self._rng
        if self._weights is None:
            worlds = rng.integers(len(self.worlds), size=n, dtype=np.int32)
        else:
            worlds = rng.choice(len(self.worlds), size=n, p=self._weights).astype(np.int32)
        self._start[cars] = rng.integers(N_STARTS, size=n)
        self._place(cars, worlds, self.starts[worlds, self._start[cars]])

    def _place(self, cars: NDArray[np.intp], worlds: NDArray[np.int32], poses_world: NDArray[np.float64]) -> None:
        sim, rng = self.sim, self._rng
        poses = poses_world.copy()
        poses[:, :2] -= sim.origin[worlds]
        dynamics = draw_dynamics(self.task.dynamics, rng, len(cars))
        self._noise_base[cars] = rng.integers(2**31, size=len(cars), dtype=np.int32) - self._n_steps
        host = (worlds, poses.astype(np.float32), dynamics.astype(np.float32))
        sim.place(cars, *(like(values, sim.pose) for values in host))
        sim.margin[cars] = like(draw_margins(self._margins, worlds, rng), sim.pose)
        sim.draws[cars] = like(self._noise_base[cars] + self._n_steps, sim.draws)
        sim.command[cars] = 0.0
        self._trail.begin(cars)
        lines, most = self._lines[worlds].astype(np.float32), self._max_steps[worlds].astype(np.int32)
        gates = None if self._gates is None else like(self._gates[worlds].astype(np.float32), sim.pose)
        self._rules.begin(cars, sim.pose[cars], like(lines, sim.pose), like(most, sim.world), gates)

    def _obs(self) -> Array:
        ranges = self.sim.ranges
        return ranges[:, : len(self._seen)] if self._all_seen else ranges[:, self._seen]

    def _observe(self, cars: NDArray[np.intp] | slice = slice(None)) -> Array:
        return self.spec.encode_cars(self._obs()[cars], self.sim.command[cars], trail=self._trail.look(cars))

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray]]:
        """Return copies of all that a later `load` needs to go on here: plain values, as JSON has them, and arrays.

        The worlds themselves are not in it: cars that load it must have them, those of `add_worlds` too.
        """
        plain = {"n_steps": self._n_steps, "rng": self._rng.bit_generator.state}
        plain["weights"] = None if self._weights is None else self._weights.tolist()
        arrays = {name: on_host(array).copy() for name, array in self._arrays().items()}
        return plain | facts_of(self.task, self._fingerprints()), arrays

    def load(self, plain: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> Array:
        """Go on where `state` was taken, and return the (N, size) observations there.

        Raises:
            ConfigError: it was taken under another task or among other worlds.
            ValueError, KeyError: these are not arrays of such cars; kernels would read beyond them.
        """
        require_state_of(plain, self.task, self._fingerprints())
        require_arrays(arrays, self._arrays(), {"world": len(self.worlds), "start": N_STARTS})
        self.weights = plain.get("weights")
        self._n_steps, self.begun = plain["n_steps"], True
        self._rng.bit_generator.state = plain["rng"]
        for name, array in self._arrays().items():
            array[...] = like(arrays[name], array)
        return self._observe()

    def _fingerprints(self) -> list[str]:
        self._known += map(fingerprint, self.worlds[len(self._known) :])
        return self._known

    def _arrays(self) -> dict[str, Array]:
        own = {"command": self.sim.command, "start": self._start, "noise_base": self._noise_base}
        return self.sim.state() | self._rules.state() | self._trail.state() | own
