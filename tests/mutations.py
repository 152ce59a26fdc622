"""Files that mean harm: each function spoils a good file in one way that chance picks."""

import io
import json
import random
import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from safetensors.numpy import load, save

Mutate = Callable[[bytes, random.Random], bytes]

TEXTS = (
    *("", "x" * 5000, "../../../etc/passwd", "/dev/zero", "\x00", "é", "-nan", "nan", ".inf", "1e300", "-1", "0"),
    *("9" * 5000, "1 2 3", "[", "package://none/x.stl", "a\nb: c", "2020-99-99"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 10**9, 10**30, -(10**30), 1e300, -1e300, 1e-300, 0.5),
    *(float("nan"), float("inf"), -float("inf"), [], {}, [[]], [0.0, 0.0, 0.0], {"a": 1}, ["a"] * 300, *TEXTS),
)
YAML_VALUES = (
    *("[" * 1000, "[" * 40 + "]" * 40, "{" * 1000, "&a [*a]", "*none", "2020-99-99", "2020-01-01", "!!binary aGk="),
    *("!!set {a, b}", "!!python/object/apply:os.system [true]", "? [a]", "1:" * 200 + "1", "9" * 5000, "!!timestamp x"),
    "{x: &a [1, 2, 3], y: &b [*a, *a, *a, *a, *a, *a, *a, *a], z: &c [*b, *b, *b, *b, *b, *b, *b, *b],"
    " u: &d [*c, *c, *c, *c, *c, *c, *c, *c], v: &e [*d, *d, *d, *d, *d, *d, *d, *d], w: [*e, *e, *e, *e, *e, *e, *e]}",
)


def some_bytes(data: bytes, chance: random.Random) -> bytes:
    """Cut, flip, repeat or insert bytes."""
    at, end = sorted(chance.randrange(len(data) + 1) for _ in range(2))
    noise = bytes(chance.randrange(256) for _ in range(chance.randrange(1, 16)))
    return chance.choice(
        [
            data[:at],
            data[at:],
            data[:at] + noise + data[end:],
            data[:end] + data[at:],
            data[:at] + noise + data[at:],
            b"",
        ]
    )


def some_text(data: bytes, chance: random.Random) -> bytes:
    """Spoil a word of a text, or write it in another encoding."""
    if chance.random() < 0.1:
        return data + " é".encode(chance.choice(["latin-1", "utf-16"]))
    words = data.split(b" ")
    words[chance.randrange(len(words))] = chance.choice(TEXTS).encode()
    return b" ".join(words)


def spoil(data: Any, chance: random.Random) -> Any:
    """Replace, drop, double or add one value somewhere in plain data."""
    places: list[tuple[Any, Any]] = []
    todo = [data]
    while todo:
        at = todo.pop()
        inside = list(at.items()) if isinstance(at, dict) else list(enumerate(at)) if isinstance(at, list) else []
        places += [(at, key) for key, _ in inside]
        todo += [value for _, value in inside]
    if not places or chance.random() < 0.02:
        return chance.choice(VALUES)
    at, key = chance.choice(places)
    kind = chance.random()
    if kind < 0.7:
        at[key] = chance.choice(VALUES)
    elif kind < 0.8:
        del at[key]
    elif isinstance(at, dict):
        at[chance.choice(("unknown", "x" * 5000, *map(str, at)))] = at[key]
    else:
        at.extend([at[key]] * chance.choice([1, 10, 1000]))
    return data


def json_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil a value of a JSON file."""
    if chance.random() < 0.1:
        return chance.choice([b"[" * 100_000, b'{"a":' * 5000, b"1" * 5000, b"nul", b"{}", b"\xff\xfe", b"1e999"])
    return json.dumps(spoil(json.loads(data), chance)).encode()


def yaml_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil a value of a YAML file, also by what YAML alone can say."""
    if chance.random() < 0.4:
        lines = [line for line in data.decode().splitlines() if ":" in line]
        line = chance.choice(lines)
        return data.decode().replace(line, f"{line.partition(':')[0]}: {chance.choice(YAML_VALUES)}", 1).encode()
    return yaml.safe_dump(spoil(yaml.safe_load(data), chance), allow_unicode=True).encode()


def xml_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil an attribute of an XML file, or drop or double an element, or join an element to another."""
    root = ET.fromstring(data)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    parent, child = chance.choice(parents)
    kind = chance.random()
    if kind < 0.15:
        parent.remove(child)
    elif kind < 0.3:
        parent.append(child)
    elif kind < 0.45:
        links = [link.get("name", "") for link in root.iter("link")]
        joint = chance.choice(list(root.iter("joint")))
        ends = [end for end in joint if end.tag in ("parent", "child")]
        chance.choice(ends or [joint]).set("link", chance.choice(links or [""]))
    else:
        owners = [element for element in root.iter() if element.attrib]
        owner = chance.choice(owners)
        owner.set(chance.choice(list(owner.attrib)), chance.choice([text for text in TEXTS if "\x00" not in text]))
    return ET.tostring(root)


def npz_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil an array or the header of an .npz file, or claim more than there is."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    name = chance.choice(list(arrays))
    if "header" in arrays and chance.random() < 0.5:
        arrays["header"] = np.array(json.dumps(spoil(json.loads(str(arrays["header"])), chance)))
    elif chance.random() < 0.3:
        return _with_claim(arrays, name, chance)
    else:
        arrays[name] = spoiled_array(arrays[name], chance)
    if chance.random() < 0.1:
        del arrays[name]
    made = io.BytesIO()
    np.savez_compressed(made, **arrays)
    return made.getvalue()


def spoiled_array(array: np.ndarray, chance: random.Random) -> np.ndarray:
    """Return an array of another shape, type or content."""
    numbers = np.atleast_1d(array) if array.dtype.kind in "biuf" else np.zeros(3)
    return chance.choice(
        [
            lambda: numbers[:0],
            lambda: numbers.reshape(-1)[:1],
            lambda: numbers[None],
            lambda: np.full_like(numbers, np.nan if numbers.dtype.kind == "f" else 0),
            lambda: np.full_like(numbers, 1e30 if numbers.dtype.kind == "f" else 1),
            lambda: numbers.astype(np.complex128),
            lambda: numbers.astype(str),
            lambda: np.array([{"a": 1}], dtype=object),
            lambda: np.concatenate([numbers.reshape(-1)] * 2),
            lambda: np.full_like(numbers, -1 if numbers.dtype.kind in "if" else 1),
        ]
    )()


def _with_claim(arrays: dict[str, np.ndarray], name: str, chance: random.Random) -> bytes:
    """Write an .npz one of whose arrays says in its header that it is enormous, or something else."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array)
            content = member.getvalue()
            if each == name:
                claim = chance.choice(["(10000000000000,)", "(-1,)", "(2, 3, 4, 5)", "'abc'", "(" * 200, "(True,)"])
                header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {claim}, }}\n".encode()
                content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content[-64:]
            archive.writestr(f"{each}.npy", content)
    return made.getvalue()


def safetensors_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil the header of a safetensors file, or what its texts say."""
    (n,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + n])
    texts = header.get("__metadata__", {})
    if texts and chance.random() < 0.5:
        name = chance.choice(list(texts))
        try:
            texts[name] = json.dumps(spoil(json.loads(texts[name]), chance))
        except ValueError:
            texts[name] = chance.choice(TEXTS)
        if chance.random() < 0.2:
            del texts[name]
    else:
        header = spoil(header, chance)
    if isinstance(header, dict) and chance.random() < 0.2:
        header.pop(chance.choice(list(header) or [""]), None)
    made = json.dumps(header).encode()
    length = len(made) if chance.random() < 0.9 else chance.choice([0, 2**63, 2**64 - 1, 10**9, 1])
    return struct.pack("<Q", length) + made + data[8 + n :]


def safetensors_weights(data: bytes, chance: random.Random) -> bytes:
    """Spoil a tensor of a safetensors file: its shape, its type, its numbers; or leave it out."""
    (n,) = struct.unpack("<Q", data[:8])
    texts = json.loads(data[8 : 8 + n]).get("__metadata__")
    tensors = load(data)
    name = chance.choice(list(tensors))
    if chance.random() < 0.2:
        del tensors[name]
    else:
        spoiled = spoiled_array(tensors[name], chance)
        tensors[chance.choice([name, "9.weight"])] = spoiled if spoiled.dtype.kind in "biuf" else np.zeros(0, np.uint8)
    return save({key: np.ascontiguousarray(value) for key, value in tensors.items()}, metadata=texts)


def glb_values(data: bytes, chance: random.Random) -> bytes:
    """Spoil the JSON part of a GLB, its lengths kept true."""
    (n,) = struct.unpack("<I", data[12:16])
    spoiled = json.dumps(spoil(json.loads(data[20 : 20 + n]), chance)).encode()
    spoiled += b" " * (-len(spoiled) % 4)
    rest = data[20 + n :]
    total = 20 + len(spoiled) + len(rest)
    return data[:8] + struct.pack("<I", total) + struct.pack("<I", len(spoiled)) + data[16:20] + spoiled + rest


def pgm_header(data: bytes, chance: random.Random) -> bytes:
    """Spoil the size or the greatest value that a PGM declares."""
    magic = chance.choice([b"P5", b"P2", b"P6", b"P9"])
    size = chance.choice([b"8 8", b"100000 100000", b"0 0", b"-1 5", b"8", b"20000 20000", b"1 99999999"])
    maxval = chance.choice([b"255", b"0", b"65536", b"65535", b"-1", b"x"])
    return magic + b"\n" + size + b"\n" + maxval + b"\n" + data[-64:]


def zip_members(data: bytes, chance: random.Random, inner: dict[str, Mutate]) -> bytes:
    """Spoil one member of a zip archive, or drop it, or add one."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(list(members))
    kind = chance.random()
    if kind < 0.2:
        del members[name]
    elif kind < 0.3:
        members[chance.choice(["../out", "/out", "x" * 1000, "a\\..\\b"])] = b"0"
    else:
        members[name] = inner.get(Path(name).suffix, some_bytes)(members[name], chance)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return made.getvalue()
