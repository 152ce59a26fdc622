"""The records of a comparison: five Parquet tables in a folder, the same bytes from the same rows."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import MB, refusing, require_file
from zebrat_bullet.outputs import written_whole

if TYPE_CHECKING:
    from pyarrow import Schema, Table

_WHO = {"agent": "string", "setting": "string", "study": "string", "place": "string"}
_POSES = dict.fromkeys(("x0", "y0", "yaw0", "x1", "y1", "yaw1"), "float64")

COLUMNS: dict[str, dict[str, str]] = {
    "runs": {
        **{"run": "string", "study": "string", "algorithm": "string", "reward": "string", "variant": "string"},
        **{"seed": "int64", "asked": "string", "episodes": "int64", "steps": "int64", "wall_s": "float64"},
        **{"best_success": "float64", "best_collision": "float64", "best_time_s": "float64"},
        **{"state": "string", "command": "string"},
    },
    "learning": {
        **{"run": "string", "episode": "int64", "total_steps": "int64", "best_return": "float64"},
        "success": "float64",
    },
    "episodes": {
        **{"agent": "string", "method": "string", "setting": "string", "study": "string", "run": "string"},
        **{"sim": "string", "place": "string", "family": "string", "difficulty": "float64", "reversals": "int64"},
        **{"track_seed": "int64", "seed": "int64", "episode": "int64", "noise": "string", "outcome": "string"},
        **{"duration_s": "float64", "n_reversals": "int64", "min_gap_m": "float64"},
        **{"steering_effort_rad": "float64", "distance_m": "float64", "backed_m": "float64"},
        **_POSES,
        "made_by": "string",
    },
    "paths": {**_WHO, "seed": "int64", "episode": "int64", "noise": "string", "x": "float32s", "y": "float32s"},
    "collisions": {
        **{"walls": "string", "panel": "string", "setting": "string", "representation": "string", "rays": "int64"},
        **{"margin_m": "float64", "detected": "int64", "events": "int64", "within_1_s": "int64", "recall": "float64"},
        **{"recall_low": "float64", "recall_high": "float64", "overlap_sweeps": "int64", "overlap_reports": "int64"},
        **{"false_alarms": "int64", "clear_minutes": "float64", "precision": "float64", "lead_s": "float64"},
    },
}
"""Of each table its columns and their types; "float32s" is a list of float32. What is not known is null.

runs: a training run a row. `asked` is its length as the manifest says it; `episodes` (null of planar runs, which log
    four cars only), `steps` and `wall_s` what is done of it; `best_success`, `best_collision` (0 to 1) and
    `best_time_s` (of its successes; null without) those of the best of its own noise-free evaluations; `state`
    "complete", "partial" or "missing"; `command` makes it.
learning: of each run a row for every 20 episodes with the best return among them, and one for every noise-free
    evaluation with its success; the other is null.
episodes: a judged episode a row. `agent` as `--agent` takes it, never an absolute path; `run` null of what is not
    trained here; `sim` "bullet", "planar" or "mujoco"; `place` a world or a held-out set, and of a set's tracks
    `family`, `difficulty`, `reversals` (of the certificate) and `track_seed`; `noise` "" where there is none;
    `n_reversals` how often the commanded speed changed its sign, `backed_m` the longest way in m that the car really
    drove back in one go, to 0.1 mm (null where it is not known); `min_gap_m` the smallest V_obs - V_range;
    `steering_effort_rad` the sum of |change| of the commanded steering; start pose x0, y0, yaw0 and end pose x1, y1,
    yaw1 of the body centre in m, m, rad, world frame. Planar cars leave no path: of all from `min_gap_m` to `yaw1`
    they have `backed_m` alone. `made_by` is a digest of what the outcome depends on (policy, simulator, seed, options,
    set and how many of its tracks) and, of a set, of what is kept of it: where it differs, the episodes are driven
    anew.
paths: of every episode in a world at most 64 places of the body centre in m, to the centimetre, world frame, evenly
    over its steps.
collisions: a case of the collision study a row, as its cases.csv has them; `detected` of `events` contacts in time.
"""

_MOST_BYTES = 200 * MB


def table_of(name: str, rows: Iterable[Mapping[str, Any]]) -> "Table":
    """Return a table of rows, sorted; a column that a row lacks is null.

    Raises:
        ConfigError: pyarrow is not installed.
    """
    schema = _schema(name)
    import pyarrow

    made = pyarrow.Table.from_pylist([dict(row) for row in rows], schema=schema)
    return made.sort_by([(column, "ascending") for column, kind in COLUMNS[name].items() if kind != "float32s"])


def write_tables(tables: Mapping[str, "Table"], folder: Path) -> None:
    """Write tables as `folder`/NAME.parquet, each whole or not at all."""
    from pyarrow.parquet import write_table

    for name, table in tables.items():
        with written_whole(folder / f"{name}.parquet") as part:
            write_table(table, part, compression="zstd", compression_level=9, store_schema=False)


def read_tables(folder: Path, names: Iterable[str] = tuple(COLUMNS)) -> dict[str, "Table"]:
    """Read tables in a folder: all five, or those named.

    Raises:
        ConfigError: one is not there, is no such table, or pyarrow is not installed.
    """
    read = {}
    for name in names:
        schema, path = _schema(name), folder / f"{name}.parquet"
        from pyarrow.parquet import read_table

        require_file(path, ConfigError, _MOST_BYTES)
        with refusing(path, ConfigError, f"is not the table `{name}`", "gather it anew with `zebrat reproduce`"):
            table = read_table(path)
            if missing := [column for column in schema.names if column not in table.column_names]:
                raise ValueError(f"it lacks {', '.join(missing)}")
            read[name] = table.select(schema.names).cast(schema)
    return read


def _schema(name: str) -> "Schema":
    try:
        import pyarrow
    except ImportError as error:
        raise ConfigError("tables are Parquet: install pyarrow (pip install 'zebrat-bullet[report]')") from error
    kinds = {kind: getattr(pyarrow, kind)() for kind in ("string", "int64", "float64", "float32")}
    kinds["float32s"] = pyarrow.list_(kinds["float32"])
    return pyarrow.schema([(column, kinds[kind]) for column, kind in COLUMNS[name].items()])
