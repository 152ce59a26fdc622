"""The model card beside an exported policy: what it is, what it was trained on, how to run it, its limits."""

import json
import re
from collections.abc import Sequence
from typing import Any

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.deploy.definition import DEFINITION_FILE, MODEL_FILE, Definition

_CARD = """\
# Model card: `{name}`

| | |
|---|---|
| what it does | drives a car-like robot out of a narrow passage that it has never seen; no map, no goal, no waypoint |
| sees | {sees} |
| gives | {gives}, every {step:g} s |
| network | {network} |
| for | the car `{car}`: wheelbase {wheelbase:.3g} m, lidar at ({lidar}) m from the middle of its body, on the floor; \
another needs a policy of its own |

`{model}` is the network, `{definition}` says to the last number what goes in and comes out (SI units; x forward, y \
and bearings to the left; bearing index 0 straight back). SHA-256 of the network: `{sha256}`.

## How to run it

`pip install numpy onnxruntime && pip install --no-deps zebrat-bullet`, then, every {step:g} s:

```python
from zebrat_bullet.deploy import Driver

driver = Driver.load("this folder")
decision = driver.drive_cloud(points_lidar, age_s)  # (N, 3) float32 in m, and now - its stamp; or drive_scan(...)
send(decision.command.speed_mps, decision.command.steering_rad)  # 0 m/s and decision.refusal where it refuses to guess
```

## Limits

{another}- It knows the car that it was trained for, its lidar's mount and reach ({reach:g} m), the height band from \
{low:g} to {high:g} m above the floor, and this rate.
- It looks at {n} bearings of a scan of {n_bearings}; between two of them, below the lowest beam and outside of the \
band it is blind. It is no safety device: drive with the supervisor, and with a person at the stop.
- Points of the car's own body must not be in the cloud.
- It has been judged in simulation only.

## What it was trained on

{training}
"""


def model_card(agent: PolicyAgent, definition: Definition, own_card: str, others: Sequence[str] = ()) -> str:
    """Return the card as Markdown.

    Args:
        agent, definition: the policy.
        own_card: what was written of it before.
        others: in what the car differs from that of its training.
    """
    seen, car = agent.observation, definition.car
    named = [(part["n"], part["what"]) for part in definition.data()["observation"]["parts"]]
    parts = [f"{n} x {what}" for n, what in named if not what.startswith("trail")]
    if seen.trail_steps:
        ago = ", ".join(map(str, seen.trail_steps))
        parts.append(f"{len(named) - len(parts)} x where it was {ago} steps ago by its own commands")
    sizes = " - ".join(str(n) for n in (seen.size, *(len(bias) for _, bias in agent.layers)))
    differs = "; ".join(others)
    return _CARD.format(
        name=definition.name,
        sees=f"{', '.join(parts)}: {seen.size} numbers",
        gives=f"speed up to {seen.max_speed_mps:g} m/s and steering up to {seen.max_steering_rad:g} rad",
        step=definition.control_step_s,
        network=f"{sizes}, {agent.activation}; head: {agent.head}",
        car=car.name,
        wheelbase=car.wheelbase_m,
        lidar=", ".join(f"{x:g}" for x in car.lidar_xyz_base),
        model=MODEL_FILE,
        definition=DEFINITION_FILE,
        sha256=definition.model_sha256,
        reach=seen.range_max_m,
        low=definition.flatten.height_min_m,
        high=definition.flatten.height_max_m,
        n=seen.n_rays,
        n_bearings=definition.n_bearings,
        training=_training(agent, own_card),
        another=f"- **It was trained for another car**, not judged on this one: {differs}.\n" if differs else "",
    )


def _training(agent: PolicyAgent, own_card: str) -> str:
    """Return the policy's own card without its heading, and what its file says of its origin."""
    own = re.sub(r"^# .*\n", "", own_card)
    own = re.sub(r"\[([^\]]*)\]\([\w.]+\.md\)", r"\1", own)  # the cards beside it stay behind
    settings = json.dumps(_without_folders(agent.provenance), indent=1, sort_keys=True)
    return f"{own.strip()}\n\nSettings, versions and seed of the training:\n\n```json\n{settings}\n```".strip()


def _without_folders(value: Any) -> Any:
    """Return plain data in which every path is the last of its names."""
    if isinstance(value, dict):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_folders(item) for item in value]
    return re.split(r"[/\\]", value)[-1] if isinstance(value, str) else value
