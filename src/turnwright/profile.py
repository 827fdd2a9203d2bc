"""Profiles: heights along a line of a map, or as traced by an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.polynomial.legendre import legvander

from turnwright._arrays import Compared, Floats, frozen, is_even, same_length
from turnwright._validate import check_numbers, whole_number
from turnwright.errors import InputError

__all__ = ["Profile"]

NM = 1e6
MAX_DEGREE = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile(Compared):
    """Heights along a straight line, see `line_profile` and `read_profile`.

    Parameters
    ----------
    distance
        Distance from the start of the line, or from a reference point on it; ascending. (n,) [mm]
    z
        Heights; nan where missing. (n,) [mm]
    x, y
        Positions of the heights. (n,) [mm]
    name
        Title of the profile.
    metadata
        Further entries of the instrument's file, as text.

    Raises
    ------
    InputError
        If the arrays differ in length, or the distances do not ascend.
    """

    distance: Floats
    z: Floats
    x: Floats
    y: Floats
    name: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self, nan=("z",))
        for name in ("distance", "z", "x", "y"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, finite=name != "z"))
        same_length((name, getattr(self, name)) for name in ("distance", "z", "x", "y"))
        if not (np.diff(self.distance) > 0).all():
            raise InputError("the distances of a profile do not ascend: sort them and drop repeated values")
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    @property
    def step(self) -> float:
        """Sampling step; raises `InputError` unless there are two or more evenly spaced points. [mm]."""
        if not is_even(self.distance):
            raise InputError(
                f"the profile has {self.distance.size} points{' in uneven steps' if self.distance.size > 1 else ''}, "
                "it needs at least 2, evenly spaced: interpolate it first"
            )
        return float(np.diff(self.distance).mean())

    def between(self, start: float, end: float) -> Profile:
        """Return the section from one distance to another. [mm].

        Raises
        ------
        InputError
            If the section holds no point.
        """
        chosen = (self.distance >= start) & (self.distance <= end)
        if not chosen.any():
            raise InputError(
                f"the profile has no point from {start:g} to {end:g} mm, it reaches from {self.distance[0]:g} to "
                f"{self.distance[-1]:g} mm: choose a section of it"
            )
        parts = {name: getattr(self, name)[chosen] for name in ("distance", "z", "x", "y")}
        return replace(self, **parts)

    def without(self, degree: int) -> Profile:
        """Return the profile minus its best-fit polynomial: degree 0 removes the mean, 1 a line.

        Raises
        ------
        InputError
            If the degree is not from 0 to 10, or there are too few valid heights.
        """
        degree = whole_number(degree, "degree", 0, MAX_DEGREE)
        valid = ~np.isnan(self.z)
        if np.count_nonzero(valid) <= degree:
            raise InputError(
                f"the profile has {np.count_nonzero(valid)} valid heights, a polynomial of degree {degree} needs "
                f"{degree + 1}: use a longer profile"
            )
        low, high = self.distance[valid][[0, -1]]
        terms: Floats = legvander((2 * self.distance - low - high) / ((high - low) or 1.0), degree)
        return replace(self, z=self.z - terms @ np.linalg.lstsq(terms[valid], self.z[valid])[0])

    @property
    def pa_nm(self) -> float:
        """Arithmetic mean of the absolute heights (Pa), from zero: remove the line first. [nm]."""
        return float(np.nanmean(np.abs(self.z))) * NM

    @property
    def pq_nm(self) -> float:
        """Root mean square of the heights (Pq), from zero: remove the line first. [nm]."""
        return float(np.sqrt(np.nanmean(self.z**2))) * NM

    @property
    def pt_nm(self) -> float:
        """Peak to valley of the heights (Pt). [nm]."""
        return float(np.nanmax(self.z) - np.nanmin(self.z)) * NM
