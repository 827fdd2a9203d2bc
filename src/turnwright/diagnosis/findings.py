"""Findings of a diagnosis, as numbers and sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, overload

import numpy as np

from turnwright import machine, tool
from turnwright._arrays import Floats
from turnwright._validate import key_of
from turnwright.diagnosis.error_sources import ERROR_SOURCES
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.pose import Pose

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["Contribution", "Diagnosis", "DrawnCut", "Draws", "Finding", "format_interval", "judge"]

NM = 1e6

IMPLAUSIBLE_SIGMA = 3.0
"""A finding beyond this many plausible sizes is attributed to another source."""

DISPLAY_UNITS = MappingProxyType({"mm": ("um", 1e3), "rad": ("urad", 1e6), "rad^2": ("1e-6 rad^2", 1e6)})

REMEDY = MappingProxyType(
    {
        "offset x": "move the tool by {back} along X, or plan with the actual offset",
        "offset y": "move the tool by {back} in height, or plan with the actual offset",
        "offset z": "move the tool by {back} along Z",
        "radius error": "plan with the actual nose radius",
        "waviness": "plan with the actual edge",
        "squareness": "plan with the actual squareness, or rotate the slide by {back}",
        "straightness": "plan with the actual straightness",
        "servo lag": "advance Z by this angle: state a dead time in the machine file, or clock the part",
        "servo amplitude": "set the response of Z in the machine file, and precorrect",
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One number of an error source.

    Parameters
    ----------
    name
        Name of the number, such as ``"offset x"`` or ``"waviness c2"``.
    error_source
        Error source that it belongs to, such as ``"waviness"``.
    value, unit
        Real minus planned tool or machine; of several maps the value that they share. [unit]
    plausible
        Plausible size, one standard deviation of the prior. [unit]
    standard_uncertainty
        Standard uncertainty of the value, with all other sources and terms in the fit. [unit]
    interval
        95 % confidence interval (low, high). [unit]
    rms_nm, pv_nm
        Effect of the value on the form, beyond a change of pose.
    correlated_with
        Findings that are strongly correlated with it, each with the correlation.
    determined
        Whether the maps determine it: its uncertainty is below half of the plausible size.
    verdict
        ``"correct"`` or ``"do not correct"``.
    explanation
        The reason, in one sentence.
    repeatable
        Whether it is the same in all maps, within what is worth a correction; ``None`` for a single map.
    map_values
        The value in each map if it does not repeat, else empty. (maps,) [unit]
    """

    name: str
    error_source: str
    value: float
    unit: str
    plausible: float
    standard_uncertainty: float
    interval: tuple[float, float]
    rms_nm: float
    pv_nm: float
    correlated_with: tuple[tuple[str, float], ...]
    determined: bool
    verdict: Literal["correct", "do not correct"] = "do not correct"
    explanation: str = ""
    repeatable: bool | None = None
    map_values: tuple[float, ...] = ()

    @property
    def implausible(self) -> bool:
        """Whether the value is so far beyond the plausible size that another source is likely."""
        return abs(self.value) > IMPLAUSIBLE_SIGMA * self.plausible


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """Effect of error motions, drift or tilt of the spindle, or of low-order form, on the form.

    Parameters
    ----------
    name
        Name of the group of terms, such as ``"axial error motion of the spindle"``.
    rms_nm, uncertainty_nm
        Most probable effect beyond a change of pose, and its standard deviation.
    common_nm
        The part of it that several maps of one part share; ``None`` for a single map.
    explanation
        The effect in one sentence.
    """

    name: str
    rms_nm: float
    uncertainty_nm: float
    common_nm: float | None
    explanation: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnCut:
    """One random draw of all uncertain quantities, for a full simulation.

    Parameters
    ----------
    number
        Number of the draw.
    tool, machine
        The real tool and machine of the draw.
    tip_motion
        Function from radius, azimuth and height of the tip, each (n,) [mm, rad], to its error along X and Z. [mm]
    rest
        Form error that no motion of the tip along X and Z causes, at the points of the draws. (n,) [mm]
    """

    number: int
    tool: Tool
    machine: Machine
    tip_motion: Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
    rest: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Possible form errors of a further part, without and with correction, as random draws of all uncertain quantities.

    Parameters
    ----------
    x, y
        Points on the part. (n,) [mm]
    before
        Cut minus design of a further part that is cut as planned. (draws, n) [mm]
    after
        The same if all sources with the verdict "correct" are corrected. (draws, n) [mm]
    single
        Whether they are based on a single map, so that repeatability is unknown.
    pose
        Height that a change of each free degree of freedom adds. (n, j) [mm]
    places
        Real positions of the points, with the uncertainty of the map's pose; one for all draws if that is certain.
        (draws, 2, n) [mm]
    unmeasured
        Fraction of the part that the map does not cover; its form is drawn too.
    cases
        Some of the draws, for full simulation.
    """

    x: Floats
    y: Floats
    before: Floats
    after: Floats
    single: bool
    pose: Floats
    places: Floats
    unmeasured: float
    cases: tuple[DrawnCut, ...]

    def rms_nm(self, heights: Floats) -> Floats:
        """Return the rms beyond a change of pose. (draws,) for heights (draws, n) [nm]."""
        q, _ = np.linalg.qr(self.pose)
        residual = heights - (heights @ q) @ q.T
        return np.asarray(np.sqrt((residual**2).mean(axis=1)) * NM)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis(Sequence[Finding]):
    """All findings of a diagnosis, with its residuals.

    Parameters
    ----------
    findings
        Findings to be corrected first, each group by its effect on the form.
    contributions
        Effects of the terms that have no single source, the largest first.
    names, correlation
        Names and correlation matrix of the source parameters; (k, k).
    residuals
        Residual of sources and terms, on the grid of each map. [mm]
    remainders
        Repeatable form error after correction of the sources, to be removed by a compensation of the form. [mm]
    fields
        The same if no source is corrected. [mm]
    poses
        Pose of each map relative to its design, in the free degrees of freedom.
    measured_rms_nm, explained_rms_nm, unexplained_rms_nm
        Deviation from the design beyond a change of pose; the part explained by sources and terms; the residual.
    noise_nm, correlated_points
        For each map: standard deviation of the residual from point to point, and the number of correlated points that
        count as one.
    repeatability_nm
        Difference between the maps of one part, rms of one map beyond a change of pose; ``None`` without two maps.
    rejected
        Number of outliers of each map.
    signatures
        Effect of every finding and contribution on each map. [mm]
    draws
        Function from the index of a map to draws of the form error of a further part.
    tool, machine
        Tool and machine of the plan with all corrections: plan with these.
    likely_tool, likely_machine
        Tool and machine of the plan with every source at its most probable value, certain or not. Their joint effect is
        known even where each single value is uncertain.
    effects_on
        Function from another part to draws of its form error by the sources alone, before and after planning with the
        likely tool and machine.
    """

    findings: tuple[Finding, ...]
    contributions: tuple[Contribution, ...]
    names: tuple[str, ...]
    correlation: Floats
    residuals: tuple[HeightMap, ...]
    remainders: tuple[HeightMap, ...]
    fields: tuple[HeightMap, ...]
    poses: tuple[Pose, ...]
    measured_rms_nm: float
    explained_rms_nm: float
    unexplained_rms_nm: float
    noise_nm: tuple[float, ...]
    correlated_points: tuple[float, ...]
    repeatability_nm: float | None
    rejected: tuple[int, ...]
    signatures: tuple[Mapping[str, HeightMap], ...]
    draws: Callable[[int], Draws]
    tool: Tool
    machine: Machine
    likely_tool: Tool
    likely_machine: Machine
    effects_on: Callable[[Part], Draws]

    @property
    def residual(self) -> HeightMap:
        """Residual of the only map, or of the first. [mm]."""
        return self.residuals[0]

    @property
    def summary(self) -> str:
        """Form error, explained part and residual, in a sentence."""
        count = sum(self.rejected)
        outliers = f"; {count} outliers beyond six standard deviations are in neither" if count else ""
        return (
            f"form error {self.measured_rms_nm:.4g} nm rms: explained {self.explained_rms_nm:.4g} nm, residual "
            f"{self.unexplained_rms_nm:.4g} nm{outliers}"
        )

    def __len__(self) -> int:
        return len(self.findings)

    @overload
    def __getitem__(self, index: int | str) -> Finding: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Finding | tuple[Finding, ...]:
        """Return a finding by its index or its name."""
        if isinstance(index, str):
            for finding in self.findings:
                if finding.name == index:
                    return finding
            names = ", ".join(finding.name for finding in self.findings)
            raise InputError(f"there is no finding {index!r} among {names}: name one of them")
        return self.findings[index]


def _find_display_unit(unit: str) -> tuple[str, float]:
    return (f"um{unit[2:]}", 1e3) if unit.startswith("mm/") else DISPLAY_UNITS.get(unit, (unit, 1.0))


def format_value(value: float, unit: str) -> str:
    """Return a value with its display unit."""
    name, factor = _find_display_unit(unit)
    return f"{value * factor:+.4g} {name}".strip()


def format_interval(value: float, half: float, unit: str) -> str:
    """Return a value with its 95 % uncertainty, to two digits of the uncertainty.

    >>> format_interval(3.004e-3, 0.6076e-3, "mm")
    '+3.00 um within 0.61 um (95 %)'
    """
    name, factor = _find_display_unit(unit)
    if not 0 < half * factor < math.inf:
        return format_value(value, unit)
    places = min(9, max(0, 1 - math.floor(math.log10(half * factor))))
    return f"{value * factor:+.{places}f} {name} within {half * factor:.{places}f} {name} (95 %)".replace("  ", " ")


def judge(
    finding: Finding, *, seen: bool, rms_nm: float, certain: bool, steady: bool, allowed: bool, min_effect_nm: float
) -> Finding:
    """Return a finding with its verdict and the reason.

    Parameters
    ----------
    finding
        The finding without verdict.
    seen
        Whether it has an effect beyond a change of pose.
    rms_nm
        Effect of its source on the form.
    certain
        Whether this effect is known to better than 50 %.
    steady
        Whether its change between the maps has less effect than the common part.
    allowed
        Whether tool or machine may be corrected for it.
    min_effect_nm
        Effect that is worth a correction.
    """
    name, source = finding.name, ERROR_SOURCES.get(finding.error_source)
    value = format_interval(finding.value, finding.interval[1] - finding.value, finding.unit)
    where = source.where if source else "measure another part, on which it has another signature"
    made = f"{name} is {value}, the {finding.error_source} causes {rms_nm:.3g} nm rms"
    if name == finding.error_source:
        made = f"{name} is {value} and causes {rms_nm:.3g} nm rms"
    wider = ""
    for owner, sizes in (("tool", tool.PLAUSIBLE), ("machine", machine.PLAUSIBLE)):
        if finding.error_source in sizes:
            wider = f", or state a larger {owner}.plausible.{key_of(finding.error_source)}"
    largest = format_value(IMPLAUSIBLE_SIGMA * finding.plausible, finding.unit)[1:]
    each = ", ".join(format_value(one, finding.unit) for one in finding.map_values)
    low, high = finding.interval
    reasons = (
        (not seen, f"{name} has no effect beyond a change of the free pose: {where}"),
        (
            finding.implausible,
            f"{name} would be {value}, the largest plausible value is {largest}: look for another cause{wider}",
        ),
        (not finding.determined, f"the maps do not determine {name} ({value}): {where}"),
        (low <= 0 <= high, f"{name} is {value}, which does not differ significantly from 0"),
        (source and source.mount, f"{made}, which may come from a mount that bends the part: {where}"),
        (
            each and not steady,
            f"{name} differs between the maps ({each}) and cannot be corrected by planning: find its cause",
        ),
        (not allowed, f"{made}: compensated as form, as requested"),
        (rms_nm < min_effect_nm, f"{made}, below the least effect for a correction, {min_effect_nm:g} nm"),
        (not certain, f"{made}, with an uncertainty above 50 %: {where}"),
    )
    for applies, reason in reasons:
        if applies:
            return replace(finding, explanation=reason)
    remedy = REMEDY.get(finding.error_source, "remove it at its source").format(
        back=format_value(-finding.value, finding.unit)
    )
    return replace(finding, verdict="correct", explanation=f"{made}: {remedy}")
