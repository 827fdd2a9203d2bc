"""What is found, in numbers and in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple, overload

import numpy as np

from turnwright import machine, tool
from turnwright._arrays import Floats
from turnwright._validate import key_of
from turnwright.diagnosis.causes import CAUSES, Column
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.pose import Pose

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["Contribution", "Diagnosis", "DrawnCut", "Draws", "Finding", "Said", "around", "judge"]

NM = 1e6

IMPLAUSIBLE = 3.0
"""A source of so many times what was held plausible is another one."""

SHOWN = MappingProxyType({"mm": ("um", 1e3), "rad": ("urad", 1e6), "rad^2": ("1e-6 rad^2", 1e6)})

REMEDY = MappingProxyType(
    {
        "offset x": "move the tool by {back} along X, or plan with the tool as it is",
        "offset y": "move the tool by {back} in height, or plan with the tool as it is",
        "offset z": "move the tool by {back} along Z",
        "radius error": "plan with the nose radius as it is",
        "waviness": "plan with the edge as it is",
        "squareness": "plan with the squareness as it is, or turn the slide by {back}",
        "straightness": "plan with the slide as it is",
        "servo lag": "let Z come earlier by as much, by its dead time in the machine file or a clocking of the part",
        "servo amplitude": "give the response of Z in the machine file, and precorrect",
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One number of an error source.

    Parameters
    ----------
    name
        Of the number, such as ``"offset x"`` or ``"waviness c2"``.
    cause
        That it belongs to, such as ``"waviness"``.
    value, unit
        Of the real tool or machine minus what was planned; of several maps what they share. [unit]
    plausible
        How large it was held to be beforehand, one standard deviation. [unit]
    standard_uncertainty
        Of the value, beside all other sources and terms. [unit]
    interval
        That holds the true value in 95 of 100 cases (low, high). [unit]
    rms_nm, pv_nm
        What the value makes of the form, beyond what a change of pose would take away.
    correlated_with
        Findings that it is hard to tell from, each with its correlation.
    determined
        Whether the maps tell it: its uncertainty is below half of what was plausible.
    verdict
        ``"correct"`` or ``"do not correct"``.
    why
        One sentence.
    repeatable
        Whether it is the same in all maps, within what matters on the part; ``None`` where there is only one.
    each
        The value in each map where it does not repeat, else empty. (maps,) [unit]
    """

    name: str
    cause: str
    value: float
    unit: str
    plausible: float
    standard_uncertainty: float
    interval: tuple[float, float]
    rms_nm: float
    pv_nm: float
    correlated_with: tuple[tuple[str, float], ...]
    determined: bool
    verdict: Literal["correct", "do not correct"]
    why: str
    repeatable: bool | None = None
    each: tuple[float, ...] = ()

    @property
    def implausible(self) -> bool:
        """Whether it is so far beyond what was held plausible that the cause is likely another one."""
        return abs(self.value) > IMPLAUSIBLE * self.plausible


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """What lobes, drift, tilt of the spindle or low form make of the form.

    Parameters
    ----------
    name
        Of the group of terms, such as ``"axial error motion of the spindle"``.
    rms_nm, uncertainty_nm
        Beyond what a change of pose would take away, most probable, and one standard deviation of the whole.
    common_nm
        Of it what several maps of one part share; ``None`` where there is only one.
    why
        One sentence.
    """

    name: str
    rms_nm: float
    uncertainty_nm: float
    common_nm: float | None
    why: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnCut:
    """One draw of all that is not certain, as it can be simulated in full.

    Parameters
    ----------
    number
        Of the draw.
    tool, machine
        That really cut.
    tip_motion
        From radius, azimuth and height of the tip, each (n,) [mm, rad], to how far it is off along X and Z. [mm]
    rest
        What no motion of the tip along X and Z makes, at the places of the draws. (n,) [mm]
    """

    number: int
    tool: Tool
    machine: Machine
    tip_motion: Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
    rest: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """How a part may really be off, and what the corrected sources leave of it, in draws of all that is not certain.

    Parameters
    ----------
    x, y
        Places on the part. (n,) [mm]
    before
        Cut minus design of a further part that is cut as planned. (draws, n) [mm]
    after
        The same if the sources that are called for are corrected. (draws, n) [mm]
    single
        Whether a single map shows all this, so that nothing says what of it repeats.
    pose
        What a change of the free directions adds. (n, j) [mm]
    places
        Where on the part the places really are, as far as the pose of the map is not certain; one for all draws if it
        is. (draws, 2, n) [mm]
    unmeasured
        Share of the part that the map leaves out; what it may be like there is drawn with the rest.
    cases
        Some of the draws, to be simulated in full.
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
        """Return root mean squares beyond a change of pose. (draws,) of (draws, n) [nm]."""
        q, _ = np.linalg.qr(self.pose)
        left = heights - (heights @ q) @ q.T
        return np.asarray(np.sqrt((left**2).mean(axis=1)) * NM)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis(Sequence[Finding]):
    """All findings, and what they leave.

    Parameters
    ----------
    findings
        Those to be corrected first, each by what it makes of the form.
    contributions
        Of the terms that have no single cause, the largest first.
    names, correlation
        Of the numbers of the sources; (k, k).
    residuals
        What neither sources nor terms explain, on the grid of each map. [mm]
    remainders
        What the corrected sources leave to a compensation of the form: all else that is found to repeat. [mm]
    fields
        The same if no source is corrected. [mm]
    poses
        How each map sat off its design, as far as that was left free.
    measured_rms_nm, explained_rms_nm, unexplained_rms_nm
        Departure from the design beyond a change of pose; of what sources and terms make of it; and of what is left.
    noise_nm, together
        Of each map: what is left scatters by the one from point to point, and this many points count as one.
    repeatability_nm
        What differs from one map of a part to another, rms beyond a change of pose, of one map; ``None`` without two.
    rejected
        Points of each map that stand out of the rest by so much that the fit leaves them out.
    signatures
        What every finding and contribution makes of each map. [mm]
    draws
        From the number of a map to draws of how a further part may be off.
    tool, machine
        The planned ones with all that is to be corrected: plan with these.
    likely_tool, likely_machine
        The planned ones with every source as it most probably is, certain or not. What they do together is known where
        each of them is not.
    on
        From another part to draws of how it may be off by the sources alone, and of what planning with the likely tool
        and machine leaves.
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
    together: tuple[float, ...]
    repeatability_nm: float | None
    rejected: tuple[int, ...]
    signatures: tuple[Mapping[str, HeightMap], ...]
    draws: Callable[[int], Draws]
    tool: Tool
    machine: Machine
    likely_tool: Tool
    likely_machine: Machine
    on: Callable[[Part], Draws]

    @property
    def residual(self) -> HeightMap:
        """What no cause explains in the only map, or the first. [mm]."""
        return self.residuals[0]

    @property
    def summary(self) -> str:
        """How far the part is off, what is explained of it and what is left, in a sentence."""
        out = sum(self.rejected)
        beside = f"; {out} places stand out by more than six standard deviations and are in neither" if out else ""
        return (
            f"off by {self.measured_rms_nm:.4g} nm rms: explained {self.explained_rms_nm:.4g} nm, residual "
            f"{self.unexplained_rms_nm:.4g} nm{beside}"
        )

    def __len__(self) -> int:
        return len(self.findings)

    @overload
    def __getitem__(self, index: int | str) -> Finding: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Finding | tuple[Finding, ...]:
        """Return a finding by its place or its name."""
        if isinstance(index, str):
            for finding in self.findings:
                if finding.name == index:
                    return finding
            names = ", ".join(finding.name for finding in self.findings)
            raise InputError(f"there is no finding {index!r} among {names}: name one of them")
        return self.findings[index]


def _scale(unit: str) -> tuple[str, float]:
    """Return the unit that people read a value in, and what it is multiplied by."""
    return (f"um{unit[2:]}", 1e3) if unit.startswith("mm/") else SHOWN.get(unit, (unit, 1.0))


def shown(value: float, unit: str) -> str:
    """Return a value as people read it."""
    name, factor = _scale(unit)
    return f"{value * factor:+.4g} {name}".strip()


def around(value: float, half: float, unit: str) -> str:
    """Return a value and how far it may be off, to two digits of that, with the confidence.

    >>> around(3.004e-3, 0.6076e-3, "mm")
    '+3.00 um within 0.61 um (95 %)'
    """
    name, factor = _scale(unit)
    if not 0 < half * factor < math.inf:
        return shown(value, unit)
    places = min(9, max(0, 1 - math.floor(math.log10(half * factor))))
    return f"{value * factor:+.{places}f} {name} within {half * factor:.{places}f} {name} (95 %)".replace("  ", " ")


class Said(NamedTuple):
    """What the sentence of a finding rests on."""

    column: Column
    value: float
    whole: str  # the value and half the width of its interval
    seen: bool
    determined: bool
    significant: bool  # its interval does not hold 0
    certain: bool  # what its cause makes of the form is known to a half
    rms_nm: float  # of the whole cause
    worth_nm: float
    each: Sequence[float]
    allowed: bool  # to be corrected by tool or machine, if it is certain
    steady: bool  # what changes from map to map makes less of the form than what they share


def judge(said: Said) -> tuple[Literal["correct", "do not correct"], str]:
    """Return verdict and sentence."""
    column, name = said.column, said.column.name
    known = CAUSES.get(column.cause)
    where = known.where if known else "measure another part, on which it shows otherwise"
    unknown = _unknown(said, where)
    if unknown:
        return "do not correct", unknown
    made = f"{name} is {said.whole}, the {column.cause} makes {said.rms_nm:.3g} nm rms"
    if name == column.cause:
        made = f"{name} is {said.whole} and makes {said.rms_nm:.3g} nm rms"
    left = ""
    if known and known.mount:
        left = f"{made}, as a mount does that bends the part: {where}"
    elif said.each and not said.steady:
        each = ", ".join(shown(one, column.unit) for one in said.each)
        left = f"{name} differs between the maps ({each}): find what moved, it cannot be planned away"
    elif not said.allowed:
        left = f"{made}: it is left to the form, as was asked"
    elif said.rms_nm < said.worth_nm:
        left = f"{made}, less than the {said.worth_nm:g} nm that are worth it: leave it"
    elif not said.certain:
        left = f"{made}, which is known to less than a half: {where}"
    if left:
        return "do not correct", left
    remedy = REMEDY.get(column.cause, "take it out where it comes from")
    return "correct", f"{made}: {remedy.format(back=shown(-said.value, column.unit))}"


def _unknown(said: Said, where: str) -> str:
    """Return why a number is not known, or nothing if it is."""
    column, name = said.column, said.column.name
    if not said.seen:
        return f"{name} leaves nothing that a change of pose, which is free, would not leave: {where}"
    if abs(said.value) > IMPLAUSIBLE * column.typical:
        wider = ""
        for owner, sizes in (("tool", tool.PLAUSIBLE), ("machine", machine.PLAUSIBLE)):
            if column.cause in sizes:
                wider = f", or state a larger {owner}.plausible.{key_of(column.cause)}"
        return (
            f"{name} would be {said.whole}, {shown(IMPLAUSIBLE * column.typical, column.unit)[1:]} is the largest that "
            f"is plausible: look for another cause{wider}"
        )
    if not said.determined:
        return f"the maps hardly tell {name} ({said.whole}): {where}"
    return "" if said.significant else f"{name} is {said.whole}, which may be nothing: leave it"
