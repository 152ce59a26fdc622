"""What is varied in the study of representations: cases of a sensing and a representation, grouped in panels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zebrat_bullet.detection.representations import KINDS, RAY_REPRESENTATIONS, Representation
from zebrat_bullet.detection.scoring import Sensing
from zebrat_bullet.errors import ConfigError

MARGINS_M = tuple(float(margin) for margin in np.arange(0.0, 0.15001, 0.0025).round(4))
RAYS = (8, 12, 18, 24, 32, 48, 64, 96, 128, 180, 360)
RATES_HZ = (5.0, 10.0, 20.0)
BEARINGS = (180, 360, 720, 1440)
SIGMAS_M = (0.0, 0.008, 0.02, 0.05)
DROPOUTS = (0.05, 0.2, 0.5)
POST_RAYS = (64, 128, 360)
POSTS = ("posts-0.02", "posts-0.05", "posts-0.1", "posts-0.2")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One line of the study.

    Attributes:
        panel: what is varied; "base" varies the representation only.
        setting: the value it has here.
        sensing, representation: what is scored.
    """

    panel: str
    setting: str
    sensing: Sensing
    representation: Representation


def cases(panels: Sequence[str], base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
    """Return the cases of some panels: each varies one thing about the given sensing and number of rays.

    Args:
        panels: names of `PANELS`.
        base: the sensing.
        n_rays: rays of each representation.
        margins_m: the panel "base" takes the first, "margin" has its own, all others take each.

    Raises:
        ConfigError: there is no such panel, or no margin.
    """
    unknown = set(panels) - set(PANELS)
    if unknown:
        raise ConfigError(f"no panel {', '.join(sorted(unknown))}; there are {', '.join(PANELS)}")
    if not margins_m:
        raise ConfigError("name at least one margin")
    return [case for panel in panels for case in PANELS[panel](base, n_rays, margins_m)]


def post_cases(base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
    """Return the cases of a field of posts: each kind at each margin, and the safety region with more rays."""
    made = [
        what
        for margin_m in margins_m
        for what in (
            *representations(n_rays, margin_m),
            *(Representation(kind="sr", n_rays=n, margin_m=margin_m) for n in POST_RAYS),
        )
    ]
    return [_case("posts", f"{what.n_rays} rays", base, what) for what in made]


def representations(n_rays: int, margin_m: float) -> list[Representation]:
    """Return one of each kind."""
    return [Representation(kind=kind, n_rays=0 if kind == "cloud" else n_rays, margin_m=margin_m) for kind in KINDS]


Panel = Callable[[Sensing, int, Sequence[float]], list[Case]]


def _base(base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
    return [_case("base", "", base, what) for what in representations(n_rays, margins_m[0])]


def _margin(base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
    return [_case("margin", f"{m:g} m", base, what) for m in MARGINS_M for what in representations(n_rays, m)]


def _rays(base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
    made = [Representation(kind=k, n_rays=n, margin_m=m) for m in margins_m for n in RAYS for k in RAY_REPRESENTATIONS]
    return [_case("rays", f"{what.n_rays} rays", base, what) for what in made]


def _sensing(name: str, variants: Callable[[Sensing], dict[str, Sensing]]) -> Panel:
    def panel(base: Sensing, n_rays: int, margins_m: Sequence[float]) -> list[Case]:
        made = [what for margin_m in margins_m for what in representations(n_rays, margin_m)]
        return [_case(name, setting, sensing, what) for setting, sensing in variants(base).items() for what in made]

    return panel


def _rates(base: Sensing) -> dict[str, Sensing]:
    return {f"{rate:g} Hz": replace(base, rate_hz=rate) for rate in RATES_HZ}


def _resolutions(base: Sensing) -> dict[str, Sensing]:
    return {f"{n} bearings": replace(base, lidar=replace(base.lidar, n_bearings=n)) for n in BEARINGS}


def _noises(base: Sensing) -> dict[str, Sensing]:
    made = {f"sigma {s:g} m": replace(base, noise=replace(base.noise, range_sigma_m=s)) for s in SIGMAS_M}
    return made | {f"dropout {d:g}": replace(base, noise=replace(base.noise, dropout=d)) for d in DROPOUTS}


def _casters(base: Sensing) -> dict[str, Sensing]:
    return {name: replace(base, lidar=replace(base.lidar, caster=name)) for name in ("embree", "bullet")}


def _case(panel: str, setting: str, sensing: Sensing, representation: Representation) -> Case:
    return Case(panel=panel, setting=setting, sensing=sensing, representation=representation)


PANELS: dict[str, Panel] = {
    "base": _base,
    "margin": _margin,
    "rays": _rays,
    "rate": _sensing("rate", _rates),
    "resolution": _sensing("resolution", _resolutions),
    "noise": _sensing("noise", _noises),
    "caster": _sensing("caster", _casters),
}
