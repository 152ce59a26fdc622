"""Records on disk: arrays and a JSON header in one .npz without pickles, so that loading one can run no code."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.files import parse_json, read_npz
from zebrat_bullet.outputs import written_whole


def save_npz(path: Path, schema: str, values: Mapping[str, Any]) -> None:
    """Write values as .npz, whole or not at all; what is no array goes into the header and must be JSON.

    Args:
        path: the file; its folder is made.
        schema: name and version of what is written.
        values: arrays and plain values by name.
    """
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    header = {"schema": schema} | {name: value for name, value in values.items() if name not in arrays}
    with written_whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]


def load_npz(path: Path, schema: str) -> dict[str, Any]:
    """Return the values of a file that `save_npz` wrote; tuples come back as lists.

    Raises:
        ZebratError: it is no such file, damaged, or of another schema.
    """
    arrays = read_npz(path, ZebratError)
    header = parse_json(str(arrays.pop("header", "")), path, ZebratError)
    if not isinstance(header, dict) or header.pop("schema", None) != schema:
        raise ZebratError(f"{path}: its schema is not {schema}; name a file that was written for this")
    return header | arrays
