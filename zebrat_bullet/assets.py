"""Finds the URDFs, worlds and policies, in a checkout and in an installed wheel alike."""

from pathlib import Path

from zebrat_bullet.errors import AssetError
from zebrat_bullet.files import is_file, shown

_PACKAGE = Path(__file__).parent


def asset_folder(kind: str) -> Path:
    """Return the folder that holds `kind`, one of "urdf", "worlds" or "policies".

    The wheel carries all three inside the package; a checkout has urdf/ and worlds/ beside it.
    """
    inside = _PACKAGE / kind
    return inside if inside.is_dir() else _PACKAGE.parent / kind


def find_asset(kind: str, name: str, suffix: str) -> Path:
    """Return the path of a shipped asset by name, or of a user's own file by path.

    Raises:
        AssetError: neither a file at `name` nor a shipped asset of that name exists.
    """
    shipped = asset_folder(kind) / f"{name}{suffix}"
    if is_file(shipped):
        return shipped
    if is_file(name):
        return Path(name)
    known = ", ".join(list_assets(kind, suffix)) or "none"
    moved = "; if the car's file has moved, --robot says where it lies" if kind == "urdf" and "/" in name else ""
    raise AssetError(f"no {kind} named {shown(name)!r} and no file at that path; shipped are: {known}{moved}")


def list_assets(kind: str, suffix: str) -> list[str]:
    """Return the names of the shipped assets of a kind, sorted."""
    return sorted(path.name.removesuffix(suffix) for path in asset_folder(kind).glob(f"*{suffix}"))
