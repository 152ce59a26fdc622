"""The command that makes a policy ready for a real car: export."""

import argparse
from pathlib import Path

from zebrat_bullet.cli.common import AddCommand, Result, file_name


def export(arguments: argparse.Namespace) -> Result:
    """Write a policy as ONNX, with its definition and model card, for `zebrat_bullet.deploy` and other programs."""
    from zebrat_bullet.agents.export import export_policy, not_as_trained

    folder = arguments.out or Path("results") / f"export-{file_name(arguments.policy)}"
    made = export_policy(arguments.policy, folder, arguments.robot)
    others = not_as_trained(arguments.policy, made.car)
    result = {"folder": str(folder), "name": made.name, "car": made.car.name, "sha256": made.model_sha256}
    said = f"{made.name}, for the car {made.car.name}: {folder}"
    if others:
        said += f"\nIt was trained for another car ({'; '.join(others)}): judge it on this one before it drives there."
    return result | {"not_as_trained": others}, said


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(export)
    made.set_defaults(robot=None)  # then that of the training
    made.add_argument("policy", metavar="POLICY", help="a shipped policy, a .safetensors file or a run folder")
