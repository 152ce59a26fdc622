"""What a manifest names that may change under its name: agents, worlds and files of the user's own."""

from collections.abc import Sequence
from pathlib import Path

from zebrat_bullet.agents import FACTORIES, code_or_weights, load_agent
from zebrat_bullet.assets import find_asset, list_assets
from zebrat_bullet.comparison.policies import POLICY, sha256
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.claim import digests
from zebrat_bullet.files import is_file
from zebrat_bullet.world import parse_reference, sketch_world

_MOST_LETTERS = 200


def digest_of_agent(agent: str) -> str:
    """Return what tells an agent from another of its name: of a policy or a run's best one the SHA-256 of its file.

    Of the user's own driver `code_or_weights`; "" of planners, whose name says all.

    Raises:
        ZebratError: there is no such agent, or its code fails.
    """
    if is_file(Path(agent) / POLICY):
        return sha256(Path(agent) / POLICY)
    if is_file(agent) or agent in list_assets("policies", ".safetensors"):
        return sha256(find_asset("policies", agent, ".safetensors"))
    return "" if agent.partition(":")[0] in FACTORIES else code_or_weights(load_agent(agent, TaskConfig()))


def digest_of_world(world: str) -> str | None:
    """Return the SHA-256 of the geometry of a world of the user's own, None of a shipped one.

    Raises:
        ZebratError: there is no such world, or not even its walls can be found.
    """
    if parse_reference(world).name in list_assets("worlds", ".yaml"):
        return None
    digest: str = digests(TaskConfig(), {world: sketch_world(world)})["worlds"][world]
    return digest


def digests_of_files(options: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of each file that options of a command name, a car's URDF as it may be, by its name there.

    A file has a suffix; what it itself names, a mesh, is not looked at.
    """
    named = [option.rpartition("=")[2].strip("\"'") for option in options]
    return {name: sha256(Path(name)) for name in named if Path(name).suffix and is_file(name)}


def folder_name(named: str) -> str:
    """Return the name or path of an agent or a world as the name of one folder, never of one above."""
    name = "".join(letter if letter.isalnum() or letter in "._-=" else "-" for letter in named)
    return (f"-{name[1:]}" if name.startswith(".") else name)[-_MOST_LETTERS:]
