"""Records on disk: arrays and a JSON header in one .npz without pickles, so that loading one can run no code."""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

DAMAGE = (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile, zlib.error)
"""What reading a file that is no such record, or half of one, raises."""


def save_npz(path: Path, schema: str, values: Mapping[str, Any]) -> None:
    """Write values as .npz, whole or not at all; what is no array goes into the header and must be JSON.

    Args:
        path: the file; its folder is made.
        schema: name and version of what is written.
        values: arrays and plain values by name.
    """
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    header = {"schema": schema} | {name: value for name, value in values.items() if name not in arrays}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]
    part.replace(path)


def load_npz(path: Path, schema: str) -> dict[str, Any]:
    """Return the values of a file that `save_npz` wrote; tuples come back as lists.

    Raises:
        one of `DAMAGE`: it is no such file, damaged, or of another schema.
    """
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        if header.pop("schema") != schema:
            raise ValueError(f"its schema is not {schema}")
        return header | {name: file[name] for name in file.files if name != "header"}
