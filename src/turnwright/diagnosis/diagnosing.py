"""From measured maps to findings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._validate import between, positive
from turnwright.diagnosis.causes import CAUSES, DEFAULT, Cause, Columns
from turnwright.diagnosis.estimate import Estimate
from turnwright.diagnosis.findings import Diagnosis
from turnwright.diagnosis.model import Powers, Splines
from turnwright.diagnosis.report import Asked, reported
from turnwright.diagnosis.sight import FREE, mark, sights_of
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["diagnose", "plausible_rms_nm"]

MOST_POWERS = 9

POWERS, STRAIGHTNESS = (3, 4, 5, 6), 6
"""Powers of the sweep, and positions along X, that are looked for if nobody says otherwise."""

NM = 1e6


def diagnose(
    maps: HeightMap | Sequence[HeightMap],
    parts: Part | Sequence[Part],
    tool: Tool,
    machine: Machine,
    *,
    causes: Sequence[str | Cause] = DEFAULT,
    reference: Literal["true form", "best-fit sphere", "best-fit sphere, along its normal"] = "true form",
    free: Sequence[str] = FREE,
    waviness: Sequence[int] | Floats = POWERS,
    straightness: int = STRAIGHTNESS,
    sense: int = 1,
    feed: float = 0.0,
    worth_nm: float = 1.0,
    points: int = 60_000,
    noise_nm: float | Sequence[float] = 0.0,
    repeats: bool = True,
    correct: Sequence[str] | None = None,
) -> Diagnosis:
    """Say why a measured part is off.

    All error sources, by the exact contact of the real edge, and the pose are found in one least squares, each with a
    plausible size beforehand. Lobes of the spindle, its tilt, drift over the time of the cut and low form are in it as
    well, so that a source which any of these can imitate has the wide interval that it deserves.

    Parameters
    ----------
    maps
        Measured heights in the frame of the part, registered (see `register`) and cleaned; missing points are nan. What
        several maps share is told from what changes from one to the other.
    parts
        What was to be cut: one design for all maps, or one for each.
    tool, machine
        With which the parts were *planned*: what is found comes on top of their deviations. Each may say how large its
        errors plausibly are; else they are as large as `CAUSES` says.
    causes
        Names of `CAUSES`, or causes of your own, see `Cause`.
    reference
        What the heights count from: the frame of the part, or a sphere of best fit, as an interferometer with a
        transmission sphere shows it, along z or along the normal of that sphere.
    free
        What the measurement left open and a change of pose may explain: any of "piston", "tilt", "decentre",
        "clocking". A sphere of best fit leaves piston, slopes and power open too.
    waviness
        Powers of the sweep that are looked for, or an array with the knots of a spline over it (n,) [rad]. The first
        and the second power do nearly what an offset along X and a radius error do, and are left to these by default.
    straightness
        Positions along X where it is sought, both ends included.
    sense
        +1 where the spindle angle under the tool grew with time, -1 where it fell.
    feed
        To take the mean height of the cusps into account; 0 for maps that do not hold them. [mm/rev]
    worth_nm
        What makes less than this of the form, rms, is not worth correcting.
    points
        Most points of each map that the fit takes, evenly over its grid.
    noise_nm
        Standard deviation of a height, independent from point to point, where it is known: one for all maps, or one for
        each. The estimate takes what the maps show, and no less than this. [nm]
    repeats
        Whether the drift and the form without a source in a single map are taken to come back on the next part.
    correct
        Causes that tool and machine may be corrected for if they are certain; all if left out. The rest is left to a
        compensation of the form.

    Raises
    ------
    InputError
        If a cause or reference is not known, or too little of a map can be used.

    Sources
    -------
    [Troutman2016]_ ch. 6 has the causes, by small angles; [Danskin1967]_ the slopes of the exact marks.
    """
    maps = [maps] if isinstance(maps, HeightMap) else list(maps)
    parts = [*parts] if isinstance(parts, Sequence) else [parts] * len(maps)
    _check(maps, parts, causes, reference, free, sense)
    if feed:
        positive(feed, "feed", "mm/rev")
    positive(points, "points", "")
    thin = [one.thinned(points) for one in maps]
    noises = [noise_nm] * len(maps) if isinstance(noise_nm, int | float) else list(noise_nm)
    if len(noises) != len(maps):
        raise InputError(f"there are {len(noises)} noises and {len(maps)} maps: give one for all, or one for each")
    stated = np.array([between(one, "noise", 0.0, np.inf, "nm") for one in noises]) / NM
    basis = _basis(waviness)
    if straightness < 3:
        raise InputError(f"straightness is sought at {straightness} positions, it needs at least 3: give more")
    estimate = _estimate(
        thin, parts, tool, machine, causes=causes, reference=reference, free=free, basis=basis,
        straightness=straightness, sense=sense, feed=feed, stated=stated,
    )  # fmt: skip
    estimate.solve()
    asked = Asked(tool, machine, worth_nm, repeats, None if correct is None else frozenset(correct))
    return reported(estimate, maps, thin, parts, asked)


def plausible_rms_nm(
    part: Part, tool: Tool, machine: Machine, x: Floats, y: Floats, *, free: Sequence[str] = FREE, sense: int = 1
) -> float:
    """Return what errors of tool and machine plausibly make of a part, one standard deviation beyond its pose. [nm].

    Parameters
    ----------
    part, tool, machine
        What is cut, with which tool on which machine; see `diagnose`.
    x, y
        Where it counts, scattered. (n,) [mm]
    free
        What a change of pose may explain.
    sense
        +1 where the spindle angle under the tool grows with time, -1 where it falls.

    Raises
    ------
    InputError
        If too few of the points can be used.
    """
    design = HeightMap(x=x, y=y, z=part.surface.sag(x, y))
    estimate = _estimate(
        [design], [part], tool, machine, causes=DEFAULT, reference="true form", free=free, basis=_basis(POWERS),
        straightness=STRAIGHTNESS, sense=sense, feed=0.0, stated=np.zeros(1),
    )  # fmt: skip
    return estimate.plausible_rms(0) * NM


def _estimate(
    thin: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, machine: Machine, *, causes: Sequence[str | Cause],
    reference: str, free: Sequence[str], basis: Powers | Splines, straightness: int, sense: int, feed: float,
    stated: Floats,
) -> Estimate:  # fmt: skip
    """Return an estimate that has not looked at the heights yet."""
    sights, reach = sights_of(thin, parts, tool, tuple(free), reference, sense, feed)
    radius = max(part.radius for part in parts)
    farthest = max(float(np.nanmax(np.hypot(sight.x, sight.y))) for sight in sights)
    plausible = {**machine.plausible, **tool.plausible}
    columns = Columns(
        causes=tuple(causes),
        basis=basis,
        knots=np.linspace(0, farthest, straightness),
        reach=(reach, radius),
        nose=tool.actual_radius,
        plausible=plausible,
    )
    for sight in sights:
        mark(sight, columns)
    return Estimate(
        sights=sights, columns=columns, sense=sense, radius=[part.radius for part in parts], kinds=_kinds(parts),
        plausible=plausible,
        values=np.zeros((len(thin), len(columns.all))), scale=np.full(len(thin), np.inf), together=np.ones(len(thin)),
        stated=stated,
    )  # fmt: skip


def _kinds(parts: Sequence[Part]) -> list[int | None]:
    """Return which set of maps of one part each map belongs to, ``None`` where it is the only one of its part."""
    alike = [[other for other, its in enumerate(parts) if its == part] for part in parts]
    several = list(dict.fromkeys(one[0] for one in alike if len(one) > 1))
    return [several.index(one[0]) if len(one) > 1 else None for one in alike]


def _check(
    maps: Sequence[HeightMap], parts: Sequence[Part], causes: Sequence[str | Cause], reference: str,
    free: Sequence[str], sense: int,
) -> None:  # fmt: skip
    """Raise unless what is asked can be done."""
    if not maps or len(maps) != len(parts):
        raise InputError(f"there are {len(maps)} maps and {len(parts)} parts: give a map, and one part or one for each")
    for one in maps:
        one.require_calibrated()
    names = [cause if isinstance(cause, str) else cause.name for cause in causes]
    for cause in causes:
        if isinstance(cause, str) and cause not in CAUSES:
            raise InputError(f"the cause {cause!r} is not one of {', '.join(CAUSES)}: name one, or give a Cause")
    if not names or len(set(names)) < len(names):
        raise InputError(f"{len(names)} causes have {len(set(names))} different names: name each once, at least one")
    if reference not in REFERENCES:
        raise InputError(f"reference is {reference!r}, it can be {', '.join(map(repr, REFERENCES))}: choose one")
    for name in free:
        if name not in FREE:
            raise InputError(f"{name!r} cannot be free, only {', '.join(FREE)} can: name any of these")
    if sense not in (-1, 1):
        raise InputError(f"sense is {sense!r}, it must be 1 or -1: say whether the spindle angle grew")


REFERENCES = ("true form", "best-fit sphere", "best-fit sphere, along its normal")


def _basis(waviness: Sequence[int] | Floats) -> Powers | Splines:
    if isinstance(waviness, np.ndarray):
        knots = frozen(waviness, "the knots of the waviness")
        if knots.size < 2 or not (np.diff(knots) > 0).all():
            raise InputError(
                f"the waviness has {knots.size} knots, it needs at least 2 that ascend: sort and complete them"
            )
        return Splines(knots=knots)
    powers = tuple(waviness)
    if not powers or list(powers) != sorted(set(powers)) or not 1 <= powers[0] <= powers[-1] <= MOST_POWERS:
        raise InputError(
            f"the powers of the waviness are {powers}, they must ascend from at least 1 to at most {MOST_POWERS}: "
            "give such powers, or an array of knots"
        )
    return Powers(powers=powers)
