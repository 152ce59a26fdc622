"""The one door through which files of others come in: each is bounded before it is read, and named if it is refused.

Every reader takes the kind of error that its caller raises. What a parser raises of its own never comes out, whatever
it is: wrap a parser that is not here in `refusing`. Nothing here unpickles.
"""

import json
import math
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.outputs import written_whole

if TYPE_CHECKING:
    from PIL.Image import Image

MB = 1_000_000
MOST_DEPTH = 50
MOST_NODES = 200_000
MOST_DIGITS = 40  # the state of a random generator has 39
MOST_PIXELS = 80 * MB
MOST_MEMBERS = 100_000
IMAGE_FORMATS = ("PNG", "PPM", "BMP", "JPEG", "TIFF", "GIF", "WEBP")
_NUMBER = re.compile(r"[-+]?[0-9][0-9a-fA-F_.:xob+-]*")
_ERROR_CHARACTERS = 500


def shown(value: object, most: int = 100) -> str:
    """Return a value as a message shows it: cut where it is long."""
    text = str(value)
    return text if len(text) <= most else f"{text[: most - 20]}... ({len(text)} characters)"


@contextmanager
def refusing(path: Path | str, error: type[ZebratError], what: str, remedy: str) -> Iterator[None]:
    """Turn whatever is raised in this block into the package's error, with the file's name.

    Args:
        path: the file.
        error: what to raise.
        what: is wrong with the file if its parser fails, as in "no URDF".
        remedy: what the user can do.
    """
    try:
        yield
    except BaseException as cause:
        # Libraries in Rust panic with an exception that is no Exception.
        if not isinstance(cause, Exception) and type(cause).__name__ != "PanicException":
            raise
        if isinstance(cause, ZebratError) and shown(path) in str(cause):
            raise
        kind = type(cause).__name__
        said = (
            str(cause)
            if isinstance(cause, ZebratError) or type(cause) is ValueError
            else ": ".join(filter(None, (kind, str(cause))))
        )
        raise error(f"{shown(path)}: {what} ({shown(said, _ERROR_CHARACTERS)}); {remedy}") from cause


def is_file(path: Path | str) -> bool:
    """Return whether there is a file of this name; a name that no file can have is none."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def require_file(path: Path, error: type[ZebratError], most_bytes: int = 256 * MB) -> None:
    """Raise unless there is a plain file of at most so many bytes: for a parser that opens it itself."""
    if not is_file(path):
        raise error(f"{shown(path)}: no such file; correct its name")
    size = path.stat().st_size
    if size > most_bytes:
        raise error(f"{shown(path)}: holds {size / MB:.0f} MB, more than {most_bytes / MB:g} MB; make it smaller")


def read_bytes(path: Path, error: type[ZebratError], most_bytes: int = 256 * MB) -> bytes:
    """Return what a file holds."""
    require_file(path, error, most_bytes)
    with refusing(path, error, "cannot be read", "check who may read it"), path.open("rb") as file:
        return file.read(most_bytes)


def read_text(path: Path, error: type[ZebratError], most_bytes: int = 16 * MB) -> str:
    """Return the text of a UTF-8 file."""
    data = read_bytes(path, error, most_bytes)
    with refusing(path, error, "is not UTF-8 text", "save it with that encoding"):
        return data.decode("utf-8-sig").replace("\r\n", "\n")


def read_yaml(path: Path, error: type[ZebratError]) -> Any:
    """Return the plain data of a YAML file; see `parse_yaml`."""
    return parse_yaml(read_text(path, error, 4 * MB), path, error)


def parse_yaml(text: str, source: Path | str, error: type[ZebratError]) -> Any:
    """Return the plain data in a YAML text: mappings with text keys, lists, texts, numbers, truth values and None."""
    import yaml

    with refusing(source, error, "is not readable as YAML", "mend what it names"):
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        _check_yaml(text, loader)
        data = yaml.load(text, Loader=loader)
        _check_plain(data)
        return data


def _check_yaml(text: str, loader: Any) -> None:
    """Refuse deep nesting, aliases that multiply and endless numbers, before anything is made of them."""
    import yaml

    sizes: dict[str, int] = {}
    # Name of the anchor (or None) and number of nodes so far, of each collection that is open.
    open_: list[tuple[str | None, int]] = [(None, 0)]
    for event in yaml.parse(text, Loader=loader):
        anchor, grown = getattr(event, "anchor", None), 0
        if isinstance(event, yaml.AliasEvent):
            if anchor not in sizes:
                raise ValueError(f"the alias {shown(anchor)!r} names nothing that is complete before it")
            grown = sizes[anchor]
        elif isinstance(event, yaml.ScalarEvent):
            if len(event.value) > MOST_DIGITS and not event.style and _NUMBER.fullmatch(event.value):
                raise ValueError(f"a number of {len(event.value)} digits")
            grown = 1
            sizes |= {anchor: 1} if anchor else {}
        elif isinstance(event, yaml.CollectionStartEvent):
            open_.append((anchor, 1))
        elif isinstance(event, yaml.CollectionEndEvent):
            name, grown = open_.pop()
            sizes |= {name: grown} if name else {}
        open_[-1] = open_[-1][0], open_[-1][1] + grown
        if len(open_) > MOST_DEPTH:
            raise ValueError(f"more than {MOST_DEPTH} brackets or levels within each other")
        if open_[-1][1] > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} values, aliases written out")


def _check_plain(data: object) -> None:
    """Refuse what JSON could not hold: dates, bytes, sets, keys that are no texts; and numbers beyond all use."""
    todo = [data]
    while todo:
        item = todo.pop()
        if isinstance(item, dict):
            wrong = [key for key in item if not isinstance(key, str)]
            if wrong:
                raise ValueError(f"the key {shown(wrong[0])!r} is no text: write it in quotes")
            todo += item.values()
        elif isinstance(item, list):
            todo += item
        elif not isinstance(item, str | int | float | None):
            raise ValueError(f"{shown(item)!r} is a {type(item).__name__}: write it in quotes, as a list or a number")
        elif isinstance(item, int) and abs(item) >= 10**MOST_DIGITS:
            raise ValueError(f"a number of more than {MOST_DIGITS} digits")


def read_json(path: Path, error: type[ZebratError], most_bytes: int = 16 * MB) -> Any:
    """Return what a JSON file holds."""
    return parse_json(read_text(path, error, most_bytes), path, error)


def parse_json(text: str, source: Path | str, error: type[ZebratError]) -> Any:
    """Return what a JSON text holds."""
    with refusing(source, error, "is not readable as JSON", "mend the place it names, or make the file anew"):
        return json.loads(text, parse_int=_whole)


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


@contextmanager
def open_zip(path: Path, error: type[ZebratError], most_bytes: int = 1000 * MB) -> Iterator[zipfile.ZipFile]:
    """Yield a zip archive whose members, unpacked, are of at most so many bytes together and lie within it."""
    require_file(path, error, most_bytes)
    with refusing(path, error, "is no whole zip archive", "make it anew"), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        names = [member.filename for member in members]
        if len(names) != len(set(names)) or len(names) > MOST_MEMBERS:
            raise ValueError(f"{len(names)} members; each name once, and at most {MOST_MEMBERS}")
        if any(name.startswith("/") or ".." in re.split(r"[/\\]", name) for name in names):
            raise ValueError("a member lies outside the archive; nothing was unpacked")
        if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
            raise ValueError("compressed in another way than deflate")
        size = sum(member.file_size for member in members)  # what is read of a member is never more than it declares
        if size > most_bytes:
            raise ValueError(f"unpacks to {size / MB:.0f} MB, more than {most_bytes / MB:g} MB")
        yield archive


def read_npz(path: Path, error: type[ZebratError], most_bytes: int = 256 * MB) -> dict[str, NDArray]:
    """Return the arrays of an .npz file, of at most so many bytes together; none of objects, which would be pickles."""
    with open_zip(path, error, most_bytes) as archive:
        arrays = {}
        for member in archive.infolist():
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = _read_array(stream, member.file_size)
        return arrays


def read_npy(path: Path, error: type[ZebratError], most_bytes: int = 256 * MB) -> NDArray:
    """Return the array of an .npy file."""
    require_file(path, error, most_bytes)
    with refusing(path, error, "is no whole .npy file", "make it anew"), path.open("rb") as stream:
        return _read_array(stream, path.stat().st_size)


def _read_array(stream: IO[bytes], n_bytes: int) -> NDArray:
    """Read an array whose header claims no more than there is."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"an array of version {version}")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    if dtype.kind not in "biufSU":
        raise ValueError(f"an array of {shown(dtype)}; numbers and texts only")
    count = math.prod(shape)
    if min(shape, default=0) < 0 or max(shape, default=0) > max(n_bytes, MB) or count * dtype.itemsize > n_bytes:
        raise ValueError(f"an array that claims to be {shown(shape)} of {dtype}, in {n_bytes} bytes")
    data = stream.read(count * dtype.itemsize)
    flat = np.frombuffer(data, dtype, count).copy() if count else np.zeros(0, dtype)
    return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)


def read_safetensors(
    path: Path, error: type[ZebratError], most_bytes: int = 256 * MB
) -> tuple[dict[str, str], dict[str, NDArray]]:
    """Return the texts in the header of a safetensors file, and its arrays."""
    from safetensors import safe_open

    require_file(path, error, most_bytes)
    refuses = refusing(path, error, "is no whole safetensors file", "export it again")
    with refuses, safe_open(path, framework="numpy") as file:
        header = file.metadata() or {}
        return header, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a mapping)


def write_safetensors(path: Path, tensors: Mapping[str, NDArray], texts: Mapping[str, str] | None = None) -> None:
    """Write arrays, and texts in the header, whole or not at all.

    Not by safetensors' own `save_file`, whose files others may not read, and whose error does not say a disk is full.
    """
    from safetensors.numpy import save

    rows = {name: np.asarray(array, order="C") for name, array in tensors.items()}  # it reads them as they lie
    with written_whole(path) as part:
        part.write_bytes(save(rows, dict(texts) if texts else None))


def read_image(path: Path, error: type[ZebratError], most_pixels: int = MOST_PIXELS) -> "Image":
    """Return an image whose size was checked before anything of it was decoded."""
    from PIL import Image

    require_file(path, error)
    with refusing(path, error, "is no whole image", "save it again as PNG or PGM"), warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit here is a lower one
        try:
            image = Image.open(path, formats=IMAGE_FORMATS)
            n_pixels = image.width * image.height
        except Image.DecompressionBombError as bomb:
            n_pixels = int(re.findall(r"\d+", str(bomb))[0])
        if n_pixels > most_pixels:
            raise error(
                f"{shown(path)}: has {n_pixels / MB:.0f} million pixels, more than {most_pixels / MB:g} million: crop "
                "it, or halve its size and double the resolution"
            )
        image.load()
        return image
