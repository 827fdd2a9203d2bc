"""What is found, in numbers and in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple, overload

from turnwright._arrays import Floats
from turnwright.diagnosis._causes import CAUSES, Column
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.pose import Pose

if TYPE_CHECKING:
    from turnwright.machine import Machine
    from turnwright.tool import Tool

__all__ = ["Diagnosis", "Finding", "Said", "around", "judge"]

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
    """One number that says why a part is off, beyond what the plan took into account.

    Two statements are made of each. With *all* causes that were looked for at work, ``value`` lies in ``interval``:
    wide where causes leave nearly the same mark. If only the *fewest* causes are at work that explain the maps,
    ``simplest`` lies in ``simplest_interval``, which holds what all explanations say that need one number more at most:
    narrow, and right as long as nature is as simple.

    Parameters
    ----------
    name
        Of the number, such as ``"offset x"`` or ``"waviness c2"``.
    cause
        That it belongs to, such as ``"waviness"``.
    value, unit
        Of the real tool or machine minus what was planned. [unit]
    standard_uncertainty
        Of the value, which takes into account how far the residual hangs together; infinite if a free pose hides it.
        [unit]
    interval
        That holds the true value in 95 of 100 cases (low, high). [unit]
    p_value
        Chance that noise alone would make the value as large, by the F-test.
    simplest, simplest_interval
        The same in the fewest causes that explain the maps; 0 if it is none of them. [unit]
    called_for
        Whether it is one of the fewest.
    rms_nm, pv_nm
        What the simplest value makes of the form, beyond what a change of pose would take away.
    rivals
        Causes that could take its place among the fewest.
    correlated_with
        Findings that it is hard to tell from, each with its correlation.
    determined
        Whether the maps tell it apart from the pose and from all other causes.
    verdict
        ``"correct"`` or ``"do not correct"``.
    why
        One sentence.
    repeatable
        Whether it is the same in all maps; ``None`` where there is only one.
    each
        The simplest value in each map where it does not repeat, else empty. (maps,) [unit]
    """

    name: str
    cause: str
    value: float
    unit: str
    standard_uncertainty: float
    interval: tuple[float, float]
    p_value: float
    simplest: float
    simplest_interval: tuple[float, float]
    called_for: bool
    rms_nm: float
    pv_nm: float
    rivals: tuple[str, ...]
    correlated_with: tuple[tuple[str, float], ...]
    determined: bool
    verdict: Literal["correct", "do not correct"]
    why: str
    repeatable: bool | None = None
    each: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis(Sequence[Finding]):
    """All findings, and what they leave unexplained.

    Parameters
    ----------
    findings
        Those called for first, each group by what it makes of the form.
    names, correlation
        Of the numbers that were fitted together; (k, k).
    residuals
        What no cause explains, on the grid of each map. [mm]
    poses
        How each map sat off its design, as far as that was left free.
    measured_rms_nm, explained_rms_nm, unexplained_rms_nm
        Departure from the design beyond a change of pose; of what the causes make of it; and of what is left.
    noise_nm, together
        Of each map: what is left scatters by the one from point to point, and this many points count as one.
    left_out
        Points of each map that stand out of the rest by so much that the fit leaves them out.
    signatures
        The mark of every finding in each map, as large as found. [mm]
    tool, machine
        The planned ones with all that is worth correcting: plan with these.
    """

    findings: tuple[Finding, ...]
    names: tuple[str, ...]
    correlation: Floats
    residuals: tuple[HeightMap, ...]
    poses: tuple[Pose, ...]
    measured_rms_nm: float
    explained_rms_nm: float
    unexplained_rms_nm: float
    noise_nm: tuple[float, ...]
    together: tuple[float, ...]
    left_out: tuple[int, ...]
    signatures: tuple[Mapping[str, HeightMap], ...]
    tool: Tool
    machine: Machine

    @property
    def residual(self) -> HeightMap:
        """What no cause explains in the only map, or the first. [mm]."""
        return self.residuals[0]

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
    simplest: str  # the value and its half width in the fewest causes
    whole: str  # the same with all causes
    value: float
    called: bool
    seen: bool
    rivals: Sequence[str]
    each: Sequence[float]
    rms_nm: float  # of the whole cause
    worth_nm: float
    determined: bool


def judge(said: Said) -> tuple[Literal["correct", "do not correct"], str]:
    """Return verdict and sentence."""
    column, name = said.column, said.column.name
    known = CAUSES.get(column.cause)
    where = known.where if known else "measure another part, on which it shows otherwise"
    if not said.seen:
        return "do not correct", f"{name} leaves nothing that a change of pose, which is free, would not leave: {where}"
    if not said.called:
        why = f"the maps are explained without {name}: leave it"
        if not said.determined:
            why = f"the maps are explained without {name}, but hardly tell it from other causes ({said.whole}): {where}"
        return "do not correct", why
    if said.each:
        each = ", ".join(shown(one, column.unit) for one in said.each)
        return "do not correct", f"{name} differs between the maps ({each}): find what moved, it cannot be planned away"
    made = f"{name} is {said.simplest} and makes {said.rms_nm:.3g} nm rms"
    if known and known.mount:
        return "do not correct", f"{made}, as a mount does that bends the part: {where}"
    if said.rms_nm < said.worth_nm:
        return "do not correct", f"{made}, less than the {said.worth_nm:g} nm that are worth it: leave it"
    remedy = REMEDY.get(column.cause, "take it out where it comes from")
    doubt = ""
    if said.rivals:
        doubt = f"; {' or '.join(said.rivals)} would do as well on this part, so for others {where}"
    elif not said.determined:
        doubt = f"; with all causes looked for it could be {said.whole}, so for other parts {where}"
    return "correct", f"{made}: {remedy.format(back=shown(-said.value, column.unit))}{doubt}"
