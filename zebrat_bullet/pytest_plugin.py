"""A pytest plugin: in this world, at this pose, these representations must (not) report a collision.

Every pytest run of an environment loads its plugins, so all that takes time to import waits for the first check.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zebrat_bullet.errors import ConfigError

if TYPE_CHECKING:
    from zebrat_bullet.detection.check import CollisionChecker, PoseCheck
    from zebrat_bullet.types import Pose2
    from zebrat_bullet.world.world import World

OPTIONS = ("robot", "caster", "margin_m", "n_bearings", "resolution_m")


class Checked:
    """The answer to one pose; both methods return it again, so that they can be chained.

    Attributes:
        check: what every representation says.
    """

    def __init__(self, world_name: str, check: "PoseCheck") -> None:
        self._world_name = world_name
        self.check = check

    def reports(self, *names: str) -> "Checked":
        """Assert that each of these representations reports a collision.

        Raises:
            ConfigError: no name, or one that is unknown; the message lists those that exist.
        """
        __tracebackhide__ = True
        self._expect(names, True)
        return self

    def misses(self, *names: str) -> "Checked":
        """Assert that none of these representations reports a collision.

        Raises:
            ConfigError: no name, or one that is unknown; the message lists those that exist.
        """
        __tracebackhide__ = True
        self._expect(names, False)
        return self

    def _expect(self, names: tuple[str, ...], expected: bool) -> None:
        __tracebackhide__ = True
        collides = self.check.collides
        unknown = [name for name in names if name not in collides]
        if unknown or not names:
            got = ", ".join(map(repr, unknown)) or "none"
            raise ConfigError(f"name the representations to look at: {', '.join(collides)}; got {got}")
        wrong = [name for name in names if collides[name] != expected]
        if wrong:
            pose = self.check.pose
            asked = "must report a collision, but miss it" if expected else "must not report a collision, but do"
            at = f"in {self._world_name!r} at x {pose.x:g} m, y {pose.y:g} m, yaw {pose.yaw:g} rad"
            raise AssertionError(f"{', '.join(wrong)} {asked} {at}\n{self.check.table()}")


CollisionCheck = Callable[["str | Path | World", "Pose2 | Sequence[float]"], Checked]
"""What the fixture gives a test: a world (shipped name, path, or World) and a pose (x, y in m, yaw in rad), checked."""


class _Cache:
    """Checkers by their settings and worlds by their file, made once in a test session."""

    def __init__(self) -> None:
        self._checkers: dict[tuple[Any, ...], CollisionChecker] = {}
        self._worlds: dict[tuple[str, str, int], World] = {}

    def checker(self, options: dict[str, Any]) -> "CollisionChecker":
        key = tuple(options.get(name) for name in OPTIONS)
        if key not in self._checkers:
            self._checkers[key] = _make_checker(**options)
        return self._checkers[key]

    def world(self, world: "str | Path | World", robot: str | Path) -> "World":
        if not isinstance(world, str | Path):
            return world
        from zebrat_bullet.assets import find_asset
        from zebrat_bullet.robot import load_robot
        from zebrat_bullet.world import load_world, parse_reference

        reference = parse_reference(str(world))
        path = find_asset("worlds", reference.name, ".yaml").resolve()
        key = (str(replace(reference, name=str(path))), str(robot), path.stat().st_mtime_ns)
        if key not in self._worlds:
            self._worlds[key] = load_world(world, robot=load_robot(robot))
        return self._worlds[key]

    def close(self) -> None:
        for checker in self._checkers.values():
            checker.close()


def _make_checker(
    robot: str | Path = "zebrat", caster: str = "bullet", n_bearings: int = 360, **region: Any
) -> "CollisionChecker":
    from zebrat_bullet.config import LidarConfig
    from zebrat_bullet.detection.check import CollisionChecker

    return CollisionChecker(robot, lidar=LidarConfig(caster=caster, n_bearings=n_bearings), **region)


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known, as --strict-markers wants it."""
    config.addinivalue_line("markers", f"collision({', '.join(OPTIONS)}): settings of the collision_check fixture")


@pytest.fixture(scope="session")
def _collision_cache() -> Iterator[_Cache]:
    cache = _Cache()
    yield cache
    cache.close()


@pytest.fixture
def collision_check(request: pytest.FixtureRequest, _collision_cache: _Cache) -> CollisionCheck:
    """Check a pose: `collision_check(world, pose).reports("polygon", "sr").misses("fifr")`.

    `@pytest.mark.collision(robot=..., caster=..., margin_m=..., n_bearings=..., resolution_m=...)` on a test, class or
    module changes the settings; of several markers the one nearest to the test decides each.

    Raises:
        ConfigError: a setting of the marker is unknown or out of its range, or a pose lies outside of its world.
    """
    options: dict[str, Any] = {}
    for marker in request.node.iter_markers("collision"):
        unknown = sorted(set(marker.kwargs) - set(OPTIONS))
        if marker.args or unknown:
            got = ", ".join([*map(repr, marker.args), *unknown])
            raise ConfigError(
                f"pytest.mark.collision takes {', '.join(f'{name}=' for name in OPTIONS)} only; got {got}"
            )
        options = marker.kwargs | options

    def check(world: "str | Path | World", pose: "Pose2 | Sequence[float]") -> Checked:
        from zebrat_bullet.world.poses import pose_from, require_inside

        loaded = _collision_cache.world(world, options.get("robot", "zebrat"))
        at = pose_from(pose, "the pose")
        require_inside(at, loaded, "the pose")
        return Checked(loaded.name, _collision_cache.checker(options).check(loaded, at))

    return check
