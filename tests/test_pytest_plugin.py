"""The plugin's fixture passes, fails and explains itself in a user's own test run."""

import subprocess
import sys

import pytest

# Each inner run forgets the modules that it loaded itself; loaded here, they need not be loaded anew in every run.
import zebrat_bullet.sensing.embree_caster  # noqa: F401
from zebrat_bullet.detection.check import REPRESENTATIONS

pytest_plugins = "pytester"

# Other plugins, which come with Open3D and hypothesis, take seconds to load.
QUICK = ["-p", "no:cacheprovider", "-p", "no:dash", "-p", "no:hypothesispytest"]
MY_WORLD = """
name: my_world
wall: {height_m: 1.0, thickness_m: 0.1}
start: {at_m: 1.5}
segments:
  - {straight: 6.0, width: 1.4}
"""
IMPORTS = "import math\nimport pytest\nfrom zebrat_bullet.types import Pose2\n"


@pytest.fixture
def run(pytester: pytest.Pytester):
    """Run a user's test file beside my_world.yaml: a corridor along x, its walls at y = -0.7 and 0.7."""

    def run(code: str) -> pytest.RunResult:
        pytester.path.joinpath("my_world.yaml").write_text(MY_WORLD, encoding="utf-8")
        pytester.makepyfile(IMPORTS + code)
        return pytester.runpytest_inprocess("--strict-markers", *QUICK)

    return run


def test_a_true_claim_passes_and_may_be_chained(run) -> None:
    result = run("""
def test_my_car_scrapes_the_left_wall(collision_check):
    collision_check("my_world.yaml", Pose2(2.0, 0.41, 0.0)).reports("polygon", "physics", "cloud", "sr", "fifr")

def test_my_car_drives_in_the_middle(collision_check):
    clear = collision_check("my_world.yaml", (2.0, 0.0, 0.0))
    clear.misses(*clear.check.collides)
    assert clear.check.gaps_m["sr"] == pytest.approx(0.4, abs=1e-4)
""")
    result.assert_outcomes(passed=2)


def test_a_false_claim_fails_with_a_table_of_what_each_representation_saw(run) -> None:
    result = run("""
def test_wrong(collision_check):
    collision_check("my_world.yaml", Pose2(2.0, 0.0, 0.0)).misses("sr").reports("polygon", "fifr")
""")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            '>*collision_check("my_world.yaml", Pose2(2.0, 0.0, 0.0)).misses("sr").reports("polygon", "fifr")',
            "E*AssertionError: polygon, fifr must report a collision, but miss it in 'my_world' at x 2 m, y 0 m, *",
            "E*collision *gap *bearing",
            "E*polygon *no *+0.4000 m *",
            "E*physics *no *- *-",
            "E*sr *no *+0.4000 m *-90 deg",
            "E*fifr *no *+0.4000 m *-90 deg",
        ]
    )
    assert "def reports" not in result.stdout.str()  # the user's own line is shown, not ours


def test_a_false_alarm_is_named_as_one(run) -> None:
    result = run("""
def test_wrong(collision_check):
    collision_check("my_world.yaml", Pose2(2.0, 0.41, 0.0)).misses("polygon")
""")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["E*AssertionError: polygon must not report a collision, but do*"])


def test_markers_change_the_settings_and_the_nearest_one_decides(run) -> None:
    result = run("""
POSE = Pose2(2.0, 0.37, 0.0)  # 3 cm off the left wall
pytestmark = pytest.mark.collision(caster="embree", margin_m=0.04)

def test_within_the_margin(collision_check):
    collision_check("my_world.yaml", POSE).reports("polygon", "cloud", "sr").misses("physics")

@pytest.mark.collision(margin_m=0.02, n_bearings=720, resolution_m=0.05)
def test_outside_of_the_margin(collision_check):
    collision_check("my_world.yaml", POSE).misses("polygon", "cloud", "sr")
""")
    result.assert_outcomes(passed=2)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ('collision_check("my_world.yaml", Pose2(2, 0, 0)).reports("safety")', "*'safety'*"),
        ('collision_check("my_world.yaml", Pose2(2, 0, 0)).misses()', f"*{', '.join(REPRESENTATIONS)}*"),
        ('collision_check("nowhere.yaml", Pose2(2, 0, 0))', "*AssetError: no worlds named 'nowhere.yaml'*"),
        ('collision_check("my_world.yaml", Pose2(100, 0, 0)).misses("sr")', "*lies outside 'my_world', x *"),
        ('collision_check("my_world.yaml", Pose2(2, math.nan, 0))', "*ConfigError: the pose must be finite*"),
    ],
)
def test_a_mistake_says_what_is_allowed(run, code: str, message: str) -> None:
    result = run(f"def test_mistake(collision_check):\n    {code}\n")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([f"E{message}"])


@pytest.mark.parametrize(
    ("marker", "message"),
    [
        ("margin=0.02", "*robot=, caster=, margin_m=, n_bearings=, resolution_m= only; got margin*"),
        ("caster='cuda'", "*caster must be one of bullet, embree, mujoco, got 'cuda'*"),
        ("margin_m=-1", "*margin_m must be at least 0, got -1*"),
        ("robot='tank'", "*no urdf named 'tank'*"),
    ],
)
def test_a_wrong_marker_says_what_is_allowed(run, marker: str, message: str) -> None:
    result = run(f"""
@pytest.mark.collision({marker})
def test_mistake(collision_check):
    collision_check("my_world.yaml", Pose2(2.0, 0.0, 0.0))
""")
    assert sum(result.parseoutcomes().get(outcome, 0) for outcome in ("failed", "errors")) == 1
    result.stdout.fnmatch_lines([f"E{message}"])


def test_a_world_that_a_test_made_itself_may_be_checked(run) -> None:
    result = run("""
from zebrat_bullet.world import load_world

def test_made(collision_check):
    collision_check(load_world("my_world.yaml"), Pose2(2.0, 0.41, 0.0)).reports("polygon")
""")
    result.assert_outcomes(passed=1)


def test_a_run_without_such_tests_loads_nothing_heavy(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_nothing(): pass")
    code = (
        f"import sys, pytest; pytest.main({QUICK}); "
        "assert 'zebrat_bullet.pytest_plugin' in sys.modules; "
        "print([name for name in ('pybullet', 'open3d', 'torch', 'vtkmodules', 'shapely') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=pytester.path)
    assert done.stdout.strip().splitlines()[-1] == "[]"
