"""From measured maps to findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright._validate import positive
from turnwright.diagnosis._causes import CAUSES, DEFAULT, Cause, Column, Columns
from turnwright.diagnosis._findings import Diagnosis, Finding, Said, around, judge
from turnwright.diagnosis._fit import (
    CANNOT,
    FLOOR,
    FREE,
    LEVEL,
    MISSED,
    Choice,
    Fit,
    Place,
    Reduced,
    Sight,
    choose,
    on_sphere,
    sphere_of,
)  # fmt: skip
from turnwright.diagnosis._model import Deviations, Powers, Splines, Swept
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.pose import Pose
from turnwright.tool import Tool, WavinessTable

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part

__all__ = ["diagnose"]

NM = 1e6
CENTRE = 0.05
"""Nearer to the axis than this the real tool may cut on the far side of it. [mm]"""

ROUNDS = 4
"""How often causes are chosen anew, at most."""

REJECTIONS = 8
"""How often points that stand out are looked for, at most."""

TOLD = 0.1
"""Standard uncertainty in plausible units from which one map alone does not tell a number."""

ROUGH = 0.1
"""Noise as a share of the residual, before anything is known."""

ALIKE = 0.95
"""Correlation from which two findings are named as such."""

MOST_POWERS = 9

CERTIFICATE = 721
"""Points over the arc of the edge that is found."""


def diagnose(
    maps: HeightMap | Sequence[HeightMap],
    parts: Part | Sequence[Part],
    tool: Tool,
    machine: Machine,
    *,
    causes: Sequence[str | Cause] = DEFAULT,
    reference: Literal["true form", "best-fit sphere", "best-fit sphere, along its normal"] = "true form",
    free: Sequence[str] = FREE,
    waviness: Sequence[int] | Floats = (3, 4, 5, 6),
    straightness: int = 6,
    sense: int = 1,
    feed: float = 0.0,
    worth_nm: float = 1.0,
    points: int = 60_000,
) -> Diagnosis:
    """Say why a measured part is off.

    The error is compared with the marks that each cause leaves by the exact contact of the real edge, all causes and
    the pose together. The fewest causes that explain the maps as well as all of them do are called for; the others stay
    in the fit as long as they cost those little certainty. A cause that the maps do not determine is said to be so.

    Parameters
    ----------
    maps
        Measured heights in the frame of the part, registered (see `register`) and cleaned; missing points are nan. Of
        several maps every cause is shared, unless they show that it does not repeat.
    parts
        What was to be cut: one design for all maps, or one for each.
    tool, machine
        With which the parts were *planned*: what is found comes on top of their deviations.
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
    sights, reach = _sights(thin, parts, tool, tuple(free), reference, sense, feed)
    basis = _basis(waviness)
    radius = max(part.radius for part in parts)
    if straightness < 3:
        raise InputError(f"straightness is sought at {straightness} positions, it needs at least 3: give more")
    farthest = max(float(np.nanmax(np.hypot(sight.x, sight.y))) for sight in sights)
    columns = Columns(
        causes=tuple(causes),
        basis=basis,
        knots=np.linspace(0, farthest, straightness),
        reach=(reach, radius),
        nose=tool.actual_radius,
    )
    for sight in sights:
        _mark(sight, columns)
    many = len(columns.all)
    fit = Fit(
        sights=sights, columns=columns, values=np.zeros((len(maps), many)), sense=sense,
        scale=np.full(len(maps), CANNOT), together=np.ones(len(maps)),
    )  # fmt: skip
    raw = fit.reduce(measure=False)
    usable = [k for k in range(many) if _seen(raw, fit, k)]
    for k, residual in enumerate(raw.residuals):
        count = int(np.count_nonzero(sights[k].good))
        fit.scale[k] = max(ROUGH * float(np.linalg.norm(residual)) * CANNOT / np.sqrt(count), FLOOR)
    whole: list[Place] = [(k, None) for k in usable]
    fit.solve(whole, steps=2)
    for _ in range(REJECTIONS):
        if not fit.reject():
            break
        fit.solve(whole, steps=1)
    fit.reduce(measure=True)
    fit.solve(whole, steps=2)
    kept: list[int] | None = None  # all of them so far
    apart: list[int] = []
    for rounds in range(ROUNDS):
        reduced = fit.reduce(measure=True)
        choice = _choose(fit, reduced, usable, apart)
        if rounds >= ROUNDS // 2:  # in doubt, one more rather than to and fro
            choice = choice._replace(kept=sorted({*choice.kept, *(kept or ())}))
        moving = _moving(fit, reduced, choice.kept, apart)
        if choice.kept == kept and moving == apart:
            break
        kept, apart = choice.kept, moving
        fit.solve(_places(fit, kept, apart))
    else:
        reduced = fit.reduce(measure=True)
    return _report(fit, reduced, choice, usable, apart, maps, thin, parts, tool, machine, worth_nm)


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


def _sights(
    maps: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, free: tuple[str, ...], reference: str, sense: int,
    feed: float,
) -> tuple[list[Sight], float]:  # fmt: skip
    """Return the maps as the fit sees them, and the largest sweep that they use. [rad]."""
    sights, reach = [], 0.0
    for heights, part in zip(maps, parts, strict=True):
        sight = _sight(heights, part, tool, free, reference, sense, feed)
        if not sight.good.any():
            raise InputError(
                f"0 of {sight.x.size} points of the map {heights.name!r} lie where the planned tool cuts {part.name!r} "
                f"within {part.radius:g} mm: register the map first, and give the tool of the plan"
            )
        reach = max(reach, float(np.abs(sight.sweeps.cut[sight.good]).max()))
        sights.append(sight)
    return sights, max(reach, 1e-3)


def _sight(
    heights: HeightMap, part: Part, tool: Tool, free: tuple[str, ...], reference: str, sense: int, feed: float
) -> Sight:
    """Return one map as the fit sees it."""
    where, x, y, z = _valid(heights, part)
    swept = Swept(surface=part.surface, tool=tool, sense=sense, rim=part.radius)
    sphere, pose, opened = None, np.zeros(9), free
    if reference != "true form" and x.size > 4:
        design = part.surface.sag(x, y)
        sphere = sphere_of(x, y, design)
        pose[2] = float(np.mean(design - z - _sphere_height(sphere, x, y)))
        opened = (*dict.fromkeys((*free, "piston", "sphere")),)
    sight = Sight(
        x=x, y=y, z=z, swept=swept, sweeps=swept.start(x, y), added={},
        usable=np.ones(x.size, dtype=np.bool_), good=np.ones(x.size, dtype=np.bool_),
        apart=np.zeros(x.size, dtype=np.bool_), free=opened, reference=reference, sphere=sphere, where=where,
        stands=np.zeros(x.size) if reference.endswith("normal") else None,
        cusp=feed * feed / 24, pose=pose, begun=pose.copy(),
    )  # fmt: skip
    at = swept.heights(x, y, sight.sweeps, Deviations())
    with np.errstate(invalid="ignore"):
        sight.usable &= np.isfinite(at.z) & (at.tip_radius > min(CENTRE, 0.02 * part.radius))
    sight.good = sight.usable.copy()
    return sight


def _mark(sight: Sight, columns: Columns) -> None:
    """Find the marks that add in proportion."""
    x, y, _ = sight.moved()
    sight.added = columns.added(x, y, lambda: sight.swept.heights(x, y, sight.sweeps, Deviations()))


def _valid(heights: HeightMap, part: Part) -> tuple[Bools, Floats, Floats, Floats]:
    """Return which heights are valid and on the part, and those points. The shape of the map, and each (n,) [mm]."""
    x, y = heights.points()
    where = np.isfinite(heights.z) & (np.hypot(x, y) <= part.radius)
    inside = part.surface.inside(np.ascontiguousarray(x), np.ascontiguousarray(y))
    if inside is not None:
        where &= inside
    return where, x[where], y[where], heights.z[where]


def _sphere_height(sphere: Floats, x: Floats, y: Floats) -> Floats:
    return on_sphere(sphere, x, y, np.zeros_like(x), None)[2]


def _seen(raw: Reduced, fit: Fit, k: int) -> bool:
    """Say whether anything of a mark is left that a change of pose cannot explain."""
    squares = sum(float(block[:, k] @ block[:, k]) for block in raw.blocks)
    points = sum(int(np.count_nonzero(sight.good)) for sight in fit.sights)
    return bool(np.sqrt(squares / points) > 1)  # of what CANNOT be seen


def _choose(fit: Fit, reduced: Reduced, usable: Sequence[int], apart: Sequence[int]) -> Choice:
    """Return the causes called for; those that do not repeat are kept as they are."""
    blocks = reduced.blocks
    if apart:
        blocks = []
        for block in reduced.blocks:
            q = np.linalg.qr(block[:, list(apart)])[0]
            blocks.append(block - q @ (q.T @ block))
    choice = choose(reduced._replace(blocks=blocks), fit.names, [k for k in usable if k not in apart])
    return Choice(sorted([*choice.kept, *apart]), choice.rivals, choice.spread)


def _places(fit: Fit, chosen: Sequence[int], apart: Sequence[int]) -> list[Place]:
    """Return which numbers are fitted: shared by all maps, or one for each."""
    many = len(fit.sights)
    return [(k, m) for k in chosen for m in (range(many) if k in apart else (None,))]


def _groups(names: Sequence[Column], chosen: Sequence[int]) -> list[list[int]]:
    """Return numbers that come together: those of a cause, but each power of the sweep for itself."""
    groups: dict[object, list[int]] = {}
    for k in chosen:
        groups.setdefault(k if names[k].order else names[k].cause, []).append(k)
    return list(groups.values())


def _moving(fit: Fit, reduced: Reduced, kept: Sequence[int], apart: Sequence[int]) -> list[int]:
    """Return the numbers that are not the same in all maps, by the F-test."""
    many = len(fit.sights)
    if many == 1:
        return []
    from scipy.special import fdtrc  # noqa: PLC0415 - costly to import

    def left(apart: Sequence[int]) -> tuple[float, int]:
        places = _places(fit, kept, apart)
        return reduced.least(places).left, len(places)

    moving = [k for k in apart if k in kept]
    while True:
        shared, few = left(moving)
        best: tuple[float, list[int]] | None = None
        for cause in dict.fromkeys(fit.names[k].cause for k in kept if k not in moving):
            own = [k for k in kept if fit.names[k].cause == cause]
            places = _places(fit, kept, [*moving, *own])
            std = np.sqrt(np.diag(reduced.least(places).covariance))
            if max(one for one, (k, _) in zip(std, places, strict=True) if k in own) > TOLD:
                continue  # not every map says what it is
            loose, more = left([*moving, *own])
            dof = max(reduced.effective - more, 1.0)
            f_ratio = (shared - loose) / (more - few) / max(loose / dof, 1.0)
            p_value = float(fdtrc(more - few, dof, max(f_ratio, 0.0)))
            if p_value < LEVEL / 50 and (best is None or f_ratio > best[0]):
                best = f_ratio, own
        if best is None:
            return sorted(moving)
        moving += best[1]


class _Estimates(NamedTuple):
    """What a fit says of some numbers."""

    values: Floats  # (maps, k)
    std: Floats  # (k,)
    p_value: Floats  # (k,)
    correlation: Floats  # (k, k)
    dof: float

    def half(self, k: int) -> float:
        """Return half the width of the interval that holds a number in 95 of 100 cases."""
        from scipy.special import stdtrit  # noqa: PLC0415 - costly to import

        return float(stdtrit(self.dof, 1 - MISSED / 2) * self.std[k])


def _estimates(fit: Fit, reduced: Reduced, places: list[Place]) -> _Estimates:
    """Return what the fit says of the numbers in it."""
    from scipy.special import fdtrc  # noqa: PLC0415 - costly to import

    many = len(fit.names)
    found, covariance, _ = reduced.least(places)
    std = np.sqrt(np.diag(covariance))
    dof = max(reduced.effective - len(places), 1.0)
    values, widest = np.zeros_like(fit.values), np.full(many, np.inf)
    p_value, correlation = np.ones(many), np.eye(many)
    widest[[k for k, _ in places]] = 0.0
    safe = np.where(std > 0, std, np.inf)
    for c, (k, m) in enumerate(places):
        values[slice(None) if m is None else m, k] = found[c] * reduced.typical[k]
        widest[k] = max(widest[k], std[c] * reduced.typical[k])  # of a number for each map the largest stands for all
        for d, (other, _) in enumerate(places):
            correlation[k, other] = covariance[c, d] / (safe[c] * safe[d])
    for group in _groups(fit.names, list(dict.fromkeys(k for k, _ in places))):
        own = [c for c, (k, _) in enumerate(places) if k in group]
        part = covariance[np.ix_(own, own)]
        p_value[group] = fdtrc(len(own), dof, float(found[own] @ np.linalg.pinv(part, 1e-12) @ found[own]) / len(own))
    return _Estimates(values, widest, p_value, correlation, dof)


def _marks(fit: Fit, reduced: Reduced) -> list[Floats]:
    """Return the mark of every number in each map, freed of the pose; nan where it has no point. (n, k) each."""
    marks = []
    for look, pose in zip(reduced.looks, reduced.poses, strict=True):
        j = len(look.numbers)
        own = np.full((look.good.size, len(fit.names)), np.nan)
        own[look.good] = (look.points[:, j:-1] - look.points[:, :j] @ pose[:, :-1]) / reduced.typical
        marks.append(own)
    return marks


def _sizes(fit: Fit, reduced: Reduced, values: Floats) -> tuple[Floats, Floats, dict[str, float], list[Floats]]:
    """Return rms and pv of what each number makes, rms of each cause [mm], and the marks as large as found."""
    marks = _marks(fit, reduced)
    made = [mark * own for mark, own in zip(marks, values, strict=True)]
    every = np.concatenate(made)
    rms = np.sqrt(np.nanmean(every**2, axis=0))
    pv = np.max([np.nanmax(one, axis=0) - np.nanmin(one, axis=0) for one in made], axis=0)
    causes = {}
    for cause in dict.fromkeys(column.cause for column in fit.names):
        own_columns = [k for k, column in enumerate(fit.names) if column.cause == cause]
        causes[cause] = float(np.sqrt(np.nanmean(every[:, own_columns].sum(axis=1) ** 2)))
    return rms, pv, causes, made


def _report(
    fit: Fit, reduced: Reduced, choice: Choice, usable: Sequence[int], apart: Sequence[int], maps: Sequence[HeightMap],
    thin: Sequence[HeightMap], parts: Sequence[Part], tool: Tool, machine: Machine, worth_nm: float,
) -> Diagnosis:  # fmt: skip
    """Return all that the fit says, in words and numbers."""
    whole = _estimates(fit, reduced, _places(fit, usable, apart))
    fewest = _estimates(fit, reduced, _places(fit, choice.kept, apart))
    rms, pv, by_cause, made = _sizes(fit, reduced, fit.values)
    findings = []
    for k, column in enumerate(fit.names):
        seen, called = k in usable, k in choice.kept
        value, half = float(whole.values[:, k].mean()), whole.half(k)
        simple, near = float(fit.values[:, k].mean()), fewest.half(k) if called else 0.0
        below, above = choice.spread.get(k, (-near, near))
        rivals = tuple(choice.rivals.get(column.cause, [])) if called else ()
        each = tuple(fit.values[:, k].tolist()) if k in apart else ()
        determined = seen and not rivals and bool(whole.std[k] < column.typical / 2)
        determined = determined and not (called and abs(value) < half)
        said = Said(
            column=column, simplest=around(simple, max(above, -below), column.unit),
            whole=around(value, half, column.unit), value=simple, called=called, seen=seen, rivals=rivals, each=each,
            rms_nm=by_cause[column.cause] * NM, worth_nm=worth_nm, determined=determined,
        )  # fmt: skip
        verdict, why = judge(said)
        alike = [(fit.names[k2].name, float(whole.correlation[k, k2])) for k2 in usable if k2 != k and seen]
        alike = sorted((pair for pair in alike if abs(pair[1]) > ALIKE), key=lambda pair: -abs(pair[1]))
        finding = Finding(
            name=column.name, cause=column.cause, value=value, unit=column.unit,
            standard_uncertainty=float(whole.std[k]), interval=(value - half, value + half),
            p_value=float(whole.p_value[k]), simplest=simple, simplest_interval=(simple + below, simple + above),
            called_for=called, rms_nm=float(rms[k]) * NM, pv_nm=float(pv[k]) * NM, rivals=rivals,
            correlated_with=tuple(alike), determined=determined, verdict=verdict, why=why,
            repeatable=None if len(maps) == 1 or not seen else k not in apart, each=each,
        )  # fmt: skip
        findings.append(finding)
    order = sorted(
        range(len(findings)),
        key=lambda k: (not findings[k].called_for, -by_cause[findings[k].cause], k not in usable, k),
    )
    sums, count = np.zeros(3), 0
    for root, residual, scale, look in zip(reduced.blocks, reduced.residuals, fit.scale, reduced.looks, strict=True):
        sums += [scale**2 * float(one @ one) for one in (root[:, -1], root[:, -1] - residual, residual)]
        count += look.points.shape[0]
    measured, explained, unexplained = (np.sqrt(sums / count) * NM).tolist()
    real_tool, real_machine = _corrected(findings, fit, tool, machine)
    return Diagnosis(
        findings=tuple(findings[k] for k in order),
        names=tuple(fit.names[k].name for k in usable),
        correlation=frozen(whole.correlation[np.ix_(usable, usable)], "correlation", ndim=2),
        residuals=tuple(
            _residual(fit, m, one, few, part) for m, (one, few, part) in enumerate(zip(maps, thin, parts, strict=True))
        ),
        poses=tuple(_pose(sight) for sight in fit.sights),
        measured_rms_nm=measured, explained_rms_nm=explained, unexplained_rms_nm=unexplained,
        noise_nm=tuple((fit.scale / np.sqrt(fit.together) * NM).tolist()), together=tuple(fit.together.tolist()),
        left_out=tuple(int(np.count_nonzero(sight.apart)) for sight in fit.sights),
        signatures=tuple(
            MappingProxyType({column.name: _on(one, mark[:, k], sight) for k, column in enumerate(fit.names)})
            for one, mark, sight in zip(thin, made, fit.sights, strict=True)
        ),
        tool=real_tool, machine=real_machine,
    )  # fmt: skip


def _pose(sight: Sight) -> Pose:
    return Pose.within_a_turn(sight.pose[:3].tolist(), sight.pose[3], sight.pose[4:6])


def _on(heights: HeightMap, mark: Floats, sight: Sight) -> HeightMap:
    """Return a mark on the grid of a map."""
    z = np.full(heights.z.shape, np.nan)
    z[sight.where] = mark
    return replace(heights, z=z)


def _residual(fit: Fit, m: int, heights: HeightMap, thinned: HeightMap, part: Part) -> HeightMap:
    """Return what no cause explains, over a whole map."""
    own = fit.sights[m]
    sight = own if heights is thinned else _whole(own, thinned, heights, part, fit.columns)
    residual, _ = sight.cut(fit.columns.deviations(fit.values[m]))
    for cause, mark in sight.added.items():
        residual = residual - fit.values[m][[column.cause == cause for column in fit.names]] @ mark
    residual[~(sight.good | sight.apart)] = np.nan
    return replace(_on(heights, residual, sight), name=f"{heights.name} residual".strip())


def _axes(heights: HeightMap) -> tuple[Floats, Floats]:
    """Return rows and columns of a grid."""
    rows, columns = (heights.angle, heights.radius) if heights.polar else (heights.y, heights.x)
    assert rows is not None  # noqa: S101 - a grid has both
    assert columns is not None  # noqa: S101
    return rows, columns


def _whole(thin: Sight, thinned: HeightMap, heights: HeightMap, part: Part, columns: Columns) -> Sight:
    """Return a map with all its points, where it was thinned for the fit: what held there holds around it."""
    where, x, y, z = _valid(heights, part)
    sight = replace(
        thin,
        x=x,
        y=y,
        z=z,
        where=where,
        sweeps=thin.swept.guess(x, y),
        added={},
        usable=np.isfinite(z),
        good=np.isfinite(z),
        apart=np.zeros(z.size, dtype=np.bool_),
    )
    if not heights.scattered:
        held = np.zeros(thin.where.shape, dtype=np.bool_)
        held[thin.where] = thin.good | thin.apart
        near = [_nearest(full, few) for full, few in zip(_axes(heights), _axes(thinned), strict=True)]
        sight.good = held[np.ix_(*near)][where]
    if thin.stands is not None:
        sight.stands = z
    _mark(sight, columns)
    return sight


def _nearest(full: Floats, few: Floats) -> Ints:
    """Return which of few positions along an axis, which may fall, is about the nearest to each of all. (n,)."""
    order = np.argsort(few)
    return np.asarray(np.rint(np.interp(full, few[order], order)).astype(np.int64))


def _corrected(findings: Sequence[Finding], fit: Fit, tool: Tool, machine: Machine) -> tuple[Tool, Machine]:
    """Return tool and machine with all that is worth correcting."""
    worth = {finding.name: finding.simplest for finding in findings if finding.verdict == "correct"}
    causes = {finding.cause for finding in findings if finding.verdict == "correct"}
    x, y, z = (own + worth.get(f"offset {axis}", 0.0) for own, axis in zip(tool.offset, "xyz", strict=True))
    tool = replace(
        tool,
        offset=(x, y, z),
        radius_error=tool.radius_error + worth.get("radius error", 0.0),
    )
    values = fit.values.mean(axis=0)
    if "waviness" in causes:
        tool = replace(tool, waviness=_certificate(fit, fit.columns.deviations(values), tool))
    machine = replace(machine, squareness=machine.squareness + worth.get("squareness", 0.0))
    if "straightness" in causes:
        real = fit.columns.deviations(values)
        at, error = machine.straightness or (real.knots, np.zeros_like(real.knots))
        both = np.union1d(at, real.knots)
        found = np.interp(both, real.knots, real.straightness)
        machine = replace(machine, straightness=(both, np.interp(both, at, error) + found))
    return tool, machine


def _certificate(fit: Fit, real: Deviations, tool: Tool) -> WavinessTable:
    """Return the waviness of the planned edge and that found, over the whole arc: beyond the sweeps used it runs on."""
    used = np.concatenate([sight.sweeps.cut[sight.good] for sight in fit.sights])
    low, high = float(np.nanmin(used)), float(np.nanmax(used))
    sweep = np.linspace(*tool.arc, CERTIFICATE)
    held = np.clip(sweep, low, high)
    height, slope, _ = np.tensordot(real.basis.values(held), real.waviness, (1, 0))
    return WavinessTable(sweep=sweep, deviation=tool.deviation(sweep) + height + slope * (sweep - held))
