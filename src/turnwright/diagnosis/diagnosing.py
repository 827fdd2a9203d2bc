"""Diagnosis of measured maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import between, positive
from turnwright.diagnosis.error_sources import DEFAULT, ERROR_SOURCES, Columns, ErrorSource
from turnwright.diagnosis.estimate import Estimate
from turnwright.diagnosis.findings import Diagnosis
from turnwright.diagnosis.map_points import FREE, add_signatures, prepare_maps
from turnwright.diagnosis.report import ReportRequest, write_report
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["diagnose", "plausible_rms_nm"]

MAX_POWER = 9

POWERS, STRAIGHTNESS = (3, 4, 5, 6), 6
"""Powers of the sweep, and number of positions along X, by default."""

NM = 1e6


def diagnose(
    maps: HeightMap | Sequence[HeightMap],
    parts: Part | Sequence[Part],
    tool: Tool,
    machine: Machine,
    *,
    error_sources: Sequence[str | ErrorSource] = DEFAULT,
    reference: Literal["true form", "best-fit sphere", "best-fit sphere, along its normal"] = "true form",
    free: Sequence[str] = FREE,
    waviness: Sequence[int] = POWERS,
    straightness: int = STRAIGHTNESS,
    sense: int = 1,
    feed: float = 0.0,
    min_effect_nm: float = 1.0,
    points: int = 60_000,
    noise_nm: float | Sequence[float] = 0.0,
    repeats: bool = True,
    correct: Sequence[str] | None = None,
) -> Diagnosis:
    """Attribute the form error of a measured part to error sources.

    All error sources (by the exact contact of the real edge) and the pose are estimated in one least-squares fit, each
    with a prior of plausible size. Error motions and tilt of the spindle, drift during the cut and low-order form are
    part of the fit. A source that any of these can imitate therefore gets a correspondingly wide confidence interval.

    Parameters
    ----------
    maps
        Measured heights in the frame of the part, registered (see `register`) and cleaned; missing points are nan. With
        several maps, repeatable errors are separated from those that change between the maps.
    parts
        Nominal part: one design for all maps, or one for each.
    tool, machine
        Tool and machine of the *plan*: findings add to their deviations. Both may set plausible sizes of their errors;
        the defaults are those of `ERROR_SOURCES`.
    error_sources
        Names of `ERROR_SOURCES`, or user-defined sources, see `ErrorSource`.
    reference
        Reference of the heights: the frame of the part, or the best-fit sphere, as from an interferometer with a
        transmission sphere, along z or along the normal of that sphere.
    free
        Degrees of freedom that the measurement leaves open, so that a change of pose may explain them: any of "piston",
        "tilt", "decentre", "clocking". With a best-fit sphere, piston, slopes and power are free too.
    waviness
        Powers of the sweep. The first and the second have nearly the signatures of an offset along X and of a radius
        error, and are left out by default.
    straightness
        Number of positions along X of the straightness error, both ends included.
    sense
        +1 if the spindle angle under the tool grew with time, -1 if it fell.
    feed
        Feed of the cut, for the mean height of the cusps; 0 for maps without cusps. [mm/rev]
    min_effect_nm
        Smallest effect on the form, rms, that is worth a correction.
    points
        Most points of each map in the fit, evenly over its grid.
    noise_nm
        Standard deviation of a height, independent from point to point, if known: one for all maps, or one for each.
        The fit estimates the noise from the maps, and uses at least this value. [nm]
    repeats
        Whether drift and form without a source, in a single map, are assumed to repeat on the next part.
    correct
        Sources for which tool and machine may be corrected if they are certain; by default all. The other sources are
        left to a compensation of the form.

    Raises
    ------
    InputError
        If an error source or reference is unknown, or too little of a map can be used.

    Sources
    -------
    [Troutman2016]_ ch. 6 treats the sources for small angles; [Danskin1967]_ gives the derivatives of the exact
    signatures.
    """
    maps = [maps] if isinstance(maps, HeightMap) else list(maps)
    parts = [*parts] if isinstance(parts, Sequence) else [parts] * len(maps)
    _check(maps, parts, error_sources, reference, free, sense)
    if feed:
        positive(feed, "feed", "mm/rev")
    positive(points, "points", "")
    thin = [one.thinned(points) for one in maps]
    noises = [noise_nm] * len(maps) if isinstance(noise_nm, int | float) else list(noise_nm)
    if len(noises) != len(maps):
        raise InputError(f"noise_nm has {len(noises)} values for {len(maps)} maps: set one for all, or one for each")
    stated = np.array([between(one, "noise", 0.0, np.inf, "nm") for one in noises]) / NM
    _check_powers(waviness)
    if straightness < 3:
        raise InputError(f"straightness is {straightness} positions, it must be at least 3")
    estimate = _set_up_estimate(
        thin, parts, tool, machine, error_sources=error_sources, reference=reference, free=free, powers=waviness,
        straightness=straightness, sense=sense, feed=feed, stated=stated,
    )  # fmt: skip
    estimate.solve()
    report_request = ReportRequest(
        tool, machine, min_effect_nm, repeats, None if correct is None else frozenset(correct)
    )
    return write_report(estimate, maps, thin, parts, report_request)


def plausible_rms_nm(
    part: Part, tool: Tool, machine: Machine, x: Floats, y: Floats, *, free: Sequence[str] = FREE, sense: int = 1
) -> float:
    """Return the plausible form error by tool and machine beyond a change of pose, one standard deviation. [nm].

    Parameters
    ----------
    part, tool, machine
        Nominal part, tool and machine; see `diagnose`.
    x, y
        Points at which the form counts, scattered. (n,) [mm]
    free
        Degrees of freedom that a change of pose may explain.
    sense
        +1 if the spindle angle under the tool grows with time, -1 if it falls.

    Raises
    ------
    InputError
        If too few of the points can be used.
    """
    design = HeightMap(x=x, y=y, z=part.surface.sag(x, y))
    estimate = _set_up_estimate(
        [design], [part], tool, machine, error_sources=DEFAULT, reference="true form", free=free, powers=POWERS,
        straightness=STRAIGHTNESS, sense=sense, feed=0.0, stated=np.zeros(1),
    )  # fmt: skip
    return estimate.plausible_rms(0) * NM


def _set_up_estimate(
    thin: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, machine: Machine, *,
    error_sources: Sequence[str | ErrorSource],
    reference: str, free: Sequence[str], powers: Sequence[int], straightness: int, sense: int, feed: float,
    stated: Floats,
) -> Estimate:  # fmt: skip
    all_points, reach = prepare_maps(thin, parts, tool, tuple(free), reference, sense, feed)
    radius = max(part.reach for part in parts)
    farthest = max(float(np.nanmax(np.hypot(map_points.x, map_points.y))) for map_points in all_points)
    plausible = {**machine.plausible, **tool.plausible}
    columns = Columns(
        error_sources=tuple(error_sources),
        powers=tuple(powers),
        knots=np.linspace(0, farthest, straightness),
        reach=(reach, radius),
        nose=tool.actual_radius,
        plausible=plausible,
    )
    for map_points in all_points:
        add_signatures(map_points, columns)
    return Estimate(
        all_points=all_points, columns=columns, sense=sense, radius=[part.reach for part in parts],
        kinds=_group_maps(parts), plausible=plausible,
        values=np.zeros((len(thin), len(columns.all))), scale=np.full(len(thin), np.inf),
        correlated_points=np.ones(len(thin)), stated=stated,
    )  # fmt: skip


def _group_maps(parts: Sequence[Part]) -> list[int | None]:
    """Return for each map the number of its set of maps of one part, ``None`` if it is the only map of its part."""
    alike = [[other for other, its in enumerate(parts) if its == part] for part in parts]
    several = list(dict.fromkeys(one[0] for one in alike if len(one) > 1))
    return [several.index(one[0]) if len(one) > 1 else None for one in alike]


def _check(
    maps: Sequence[HeightMap], parts: Sequence[Part], error_sources: Sequence[str | ErrorSource], reference: str,
    free: Sequence[str], sense: int,
) -> None:  # fmt: skip
    if not maps or len(maps) != len(parts):
        raise InputError(
            f"there are {len(maps)} maps and {len(parts)} parts: pass a map, and one part or one for each map"
        )
    for one in maps:
        one.require_calibrated()
    names = [error_source if isinstance(error_source, str) else error_source.name for error_source in error_sources]
    for error_source in error_sources:
        if isinstance(error_source, str) and error_source not in ERROR_SOURCES:
            raise InputError(
                f"error source {error_source!r} is not one of {', '.join(ERROR_SOURCES)}: name one, or "
                "pass an ErrorSource"
            )
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"{len(names)} error sources have {len(set(names))} different names: name each once, at least one"
        )
    if reference not in REFERENCES:
        raise InputError(f"reference is {reference!r}, it must be one of {', '.join(map(repr, REFERENCES))}")
    for name in free:
        if name not in FREE:
            raise InputError(f"{name!r} cannot be free, only {', '.join(FREE)} can")
    if sense not in (-1, 1):
        raise InputError(f"sense is {sense!r}, it must be 1 or -1")


REFERENCES = ("true form", "best-fit sphere", "best-fit sphere, along its normal")


def _check_powers(powers: Sequence[int]) -> None:
    if not powers or list(powers) != sorted(set(powers)) or not 1 <= powers[0] <= powers[-1] <= MAX_POWER:
        raise InputError(
            f"the powers of the waviness are {tuple(powers)}, they must ascend from at least 1 to at most {MAX_POWER}"
        )
