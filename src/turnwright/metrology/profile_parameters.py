r"""Parameters of a roughness profile after ISO 21920-2.

The S-filter removes waves shorter than ``short``, the F-operation a polynomial, the L-filter waves longer than
``cutoff``; both filters are Gaussian. The section length is the cutoff. The evaluation length is a whole number of
sections, five by default, in the middle of the profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import positive, whole_number
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology.filters import filter_map

if TYPE_CHECKING:
    from turnwright.profile import Profile

NM = 1e6

DEFAULT_SECTIONS = 5

MIN_HEIGHT_SHARE = 0.10
"""Least height of a hill above the mean line, or depth of a dale below it, relative to Rz."""

MIN_LENGTH_SHARE = 0.01
"""Least length of a hill or a dale, relative to the section length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileRoughness:
    """Parameters of a roughness profile. Undefined parameters are nan; ``notes`` gives the reason.

    Parameters
    ----------
    ra_nm, rq_nm
        Mean and root-mean-square of the heights, over the evaluation length. [nm]
    rsk, rku
        Their skewness and kurtosis. [1]
    rp_nm, rv_nm, rz_nm
        Height of the highest peak, depth of the deepest pit, and their sum, each the mean over the sections. [nm]
    rt_nm
        Highest minus lowest over the evaluation length. [nm]
    rsm
        Mean spacing of the profile elements, a hill and the dale after it. [mm]
    cutoff, short
        Nesting indices of the L-filter and of the S-filter; ``None`` without one. [mm]
    sections
        Number of sections evaluated.
    notes
        Remarks on undefined parameters and omitted parts.
    """

    ra_nm: float
    rq_nm: float
    rsk: float
    rku: float
    rp_nm: float
    rv_nm: float
    rz_nm: float
    rt_nm: float
    rsm: float
    cutoff: float
    short: float | None
    sections: int
    notes: tuple[str, ...] = ()


def profile_roughness(
    profile: Profile, *, cutoff: float, short: float | None = None, form: int = 1, sections: int | None = None
) -> ProfileRoughness:
    r"""Return Ra, Rq, Rsk, Rku, Rp, Rv, Rz, Rt and RSm of a profile.

    Rz is the mean over the sections of highest minus lowest. For RSm a hill or dale below 10 % of Rz in height, or 1 %
    of the section in length, is merged with the preceding one. Elements that reach a gap of 1 % of the section or more
    do not count for RSm.

    Parameters
    ----------
    profile
        In even steps.
    cutoff
        Nesting index of the L-filter, :math:`\lambda_c`, such as 0.08 or 0.25 mm: longer waves are waviness. [mm]
    short
        Nesting index of the S-filter, :math:`\lambda_s`, such as 0.0025 mm: shorter waves are noise. [mm]
    form
        Degree of the polynomial removed first.
    sections
        Number of sections; by default five, or as many as fit.

    Raises
    ------
    InputError
        If the profile is shorter than the sections, or its steps do not fit the filters.

    Sources
    -------
    ISO 21920-2:2021, ISO 16610-21 (Gaussian), -28 (its ends); the discrimination of RSm by 10 % and 1 % is that of
    ISO 4287. From memory, not checked. Oracles: closed forms of sines and cusps, elements counted by hand.

    >>> from turnwright.profile import Profile
    >>> x = np.arange(5001) * 1e-4
    >>> sine = Profile(distance=x, z=1e-4 * np.cos(2 * np.pi * x / 0.005), x=x, y=0 * x)
    >>> rough = profile_roughness(sine, cutoff=0.08)
    >>> round(rough.ra_nm, 1), round(rough.rz_nm, 1), round(rough.rsm, 5)
    (63.7, 200.0, 0.005)
    """
    positive(cutoff, "the cutoff", "mm")
    if short is not None and positive(short, "the S-filter", "mm") >= cutoff:
        raise InputError(
            f"the S-filter must be below the cutoff, {cutoff:g} mm, got {short:g} mm: S removes the shorter waves"
        )
    step = profile.step
    length = float(np.ptp(profile.distance)) + step
    fit = int(length / cutoff * (1 + 1e-9))
    wanted = min(DEFAULT_SECTIONS, fit) if sections is None else whole_number(sections, "the sections", 1)
    if fit < max(wanted, 1):
        raise InputError(
            f"the profile is {length:.4g} mm long, {max(wanted, 1)} sections of {cutoff:g} mm need more: "
            "measure a longer one, or use a shorter cutoff"
        )
    notes = (
        []
        if wanted >= DEFAULT_SECTIONS or sections is not None
        else [f"{wanted} sections fit, the default is {DEFAULT_SECTIONS}"]
    )
    line = HeightMap(z=profile.without(form).z[None], x=profile.distance, y=np.zeros(1))
    if short is not None:
        line = filter_map(line, short, along="x")
    z = (line.z - filter_map(line, cutoff, along="x").z)[0]
    # Whole sections in the middle: the filters are least certain at the ends.
    many = round(cutoff / step)
    first = (z.size - wanted * many) // 2
    parts = z[max(first, 0) :][: wanted * many]
    counts = np.array_split(parts, wanted)
    valid = parts[~np.isnan(parts)]
    filled = [one[~np.isnan(one)] for one in counts]
    if any(one.size == 0 for one in filled):
        notes.append(f"{sum(one.size == 0 for one in filled)} sections have no valid heights and are left out")
        filled = [one for one in filled if one.size]
    if not valid.size:
        raise InputError("the profile has 0 valid heights in its sections, roughness needs 1: measure another")
    rq = float(np.sqrt(np.mean(valid**2)))
    rp, rv = (float(np.mean([(side * one).max() for one in filled])) for side in (1.0, -1.0))
    rz = rp + rv
    rsm, crossed = _element_spacing(parts, step, MIN_HEIGHT_SHARE * rz, MIN_LENGTH_SHARE * cutoff)
    if crossed:
        notes.append(f"{crossed} profile elements reach a gap without heights and do not count for rsm")
    if np.isnan(rsm):
        notes.append("rsm is nan: the evaluation length has no complete profile element")
    return ProfileRoughness(
        ra_nm=float(np.mean(np.abs(valid))) * NM,
        rq_nm=rq * NM,
        rsk=float(np.mean(valid**3)) / rq**3 if rq > 0 else float("nan"),
        rku=float(np.mean(valid**4)) / rq**4 if rq > 0 else float("nan"),
        rp_nm=rp * NM,
        rv_nm=rv * NM,
        rz_nm=rz * NM,
        rt_nm=float(np.ptp(valid)) * NM,
        rsm=rsm,
        cutoff=cutoff,
        short=short,
        sections=wanted,
        notes=tuple(notes),
    )


def _element_spacing(z: Floats, step: float, height: float, length: float) -> tuple[float, int]:
    """Return the mean spacing of profile elements, and how many reach a gap and do not count. [mm].

    An element extends from the start of one hill to the start of the next.
    """
    valid = np.flatnonzero(~np.isnan(z))
    if valid.size < 2:
        return float("nan"), 0
    wide = np.flatnonzero((np.diff(valid) > 1) & (np.diff(valid) * step >= length))
    gaps = np.column_stack([valid[wide], valid[wide + 1]])
    z = np.interp(np.arange(z.size), valid, z[valid])
    above = z > 0
    turns = np.flatnonzero(above[1:] != above[:-1])
    # Linearly interpolated crossings of the mean line, in steps.
    crossing = turns + z[turns] / (z[turns] - z[turns + 1])
    borders = np.concatenate([[0.0], crossing, [z.size - 1.0]])
    pieces = np.split(z, turns + 1)
    begins: list[float] = []
    last = 0
    for k, piece in enumerate(pieces):
        sign = 1 if piece[0] > 0 else -1
        whole_piece = 0 < k < len(pieces) - 1
        counts = np.abs(piece).max() >= height and (not whole_piece or (borders[k + 1] - borders[k]) * step >= length)
        if not counts or sign == last:
            continue
        if sign > 0 and last < 0:  # a hill after a dale: an element begins
            begins.append(float(borders[k]))
        last = sign
    start, end = np.array(begins[:-1]), np.array(begins[1:])
    broken = ((gaps[:, :1] < end) & (gaps[:, 1:] > start)).any(axis=0)
    spacing = (end - start)[~broken] * step
    return float(spacing.mean()) if spacing.size else float("nan"), int(np.count_nonzero(broken))
