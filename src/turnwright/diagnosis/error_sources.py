"""The error sources, and the error signature of each on the part."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import check_numbers, positive
from turnwright.diagnosis.model import Cutting, Deviations, raise_sweep
from turnwright.errors import InputError

__all__ = ["DEFAULT", "ERROR_SOURCES", "Column", "Columns", "ErrorSource", "SourceInfo"]


class SourceInfo(NamedTuple):
    """Prior knowledge of an error source."""

    unit: str
    typical: float  # plausible size, one standard deviation, in its unit
    where: str  # what to do if the map does not determine it
    mount: bool = False  # made by the mount, not by the cut


ERROR_SOURCES: Mapping[str, SourceInfo] = MappingProxyType(
    {
        "offset x": SourceInfo("mm", 0.05, "cut a test part with slopes, such as a concave sphere"),
        "offset y": SourceInfo("mm", 0.05, "cut a tilted flat, or measure the defect at the centre"),
        "offset z": SourceInfo("mm", 0.05, "measure the height from a reference, with the piston not free"),
        "radius error": SourceInfo("mm", 0.02, "cut a sphere and measure its radius as well as its form"),
        "waviness": SourceInfo("mm/rad^k", 0.005, "cut a test part whose slopes use more of the nose"),
        "squareness": SourceInfo("rad", 1e-4, "cut a test part with another slope, such as a flat"),
        "straightness": SourceInfo("mm", 0.002, "cut a flat"),
        "servo lag": SourceInfo("rad", 0.02, "put a fiducial on the part, and keep the clocking fixed"),
        "servo amplitude": SourceInfo("rad^2", 1e-3, "cut a part whose height changes more often per revolution"),
        "astigmatism": SourceInfo("mm", 0.005, "measure the part again, rotated in its mount", mount=True),
        "trefoil": SourceInfo("mm", 0.005, "measure the part again, rotated in its mount", mount=True),
    }
)  # fmt: skip
"""Every error source that has a name."""

DEFAULT = (
    "offset x",
    "offset y",
    "radius error",
    "waviness",
    "squareness",
    "servo lag",
)
"""The error sources of a diagnosis by default. A bent mount looks like low-order form, which is always included."""

MAX_WAVINESS_SLOPE_RAD = 0.02
"""Plausible slope of the waviness against the nose. [rad]"""

RADIUS_ERROR_RATIO = 0.03
"""Plausible error of the nose radius, as a fraction of the radius."""

RADIUS_CHANGE_RATIO = 0.1
"""Plausible change of the local nose radius by a wave, as a fraction of the radius: near 1 the nose would be flat."""

LOBES = MappingProxyType({"astigmatism": 2, "trefoil": 3})
"""Sources of the mount, not of the cut, with their lobes per revolution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorSource:
    """A user-defined error source: an error signature that adds to the height in proportion.

    Parameters
    ----------
    name
        Its name in the shop.
    signature
        Function that returns the height that one unit of the source adds at some points. Its argument describes how the
        planned tool cut them: the fields x, y, tip_radius, tip_angle, sweep, z, zx, zy, each (n,) in mm and rad. (n,)
        [mm per unit]
    typical
        Plausible size, one standard deviation. [unit]
    unit
        Of the value.

    Raises
    ------
    InputError
        If the name is empty or that of a built-in source, or ``typical`` is not positive.
    """

    name: str
    signature: Callable[[Cutting], Floats]
    typical: float
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_numbers(self)
        if not self.name or self.name in ERROR_SOURCES:
            raise InputError(
                f"an error source has the name {self.name!r}, it must be new and not empty: choose another name"
            )
        positive(self.typical, f"typical of the error source {self.name!r}", self.unit)


class Column(NamedTuple):
    """One unknown of the fit."""

    name: str
    error_source: str
    unit: str
    typical: float
    order: int  # of a power of the sweep, else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """All unknowns of the error sources, and their relation to deviations and error signatures.

    Parameters
    ----------
    error_sources
        Names, or user-defined sources.
    powers
        Powers of the sweep that make up the waviness.
    knots
        Positions along X of the straightness error, which is 0 at both ends: a linear error is squareness. (m,) [mm]
    reach
        Largest sweep used [rad], and radius of the part [mm].
    nose
        Nose radius of the tool. [mm]
    plausible
        Plausible sizes that differ from the default, one standard deviation. [unit of the source]
    """

    error_sources: Sequence[str | ErrorSource]
    powers: tuple[int, ...]
    knots: Floats
    reach: tuple[float, float]
    nose: float
    plausible: Mapping[str, float]

    @property
    def all(self) -> list[Column]:
        """One column for each unknown."""
        columns: list[Column] = []
        for error_source in self.error_sources:
            if isinstance(error_source, ErrorSource):
                columns.append(Column(error_source.name, error_source.name, error_source.unit, error_source.typical, 0))
                continue
            info, stated = ERROR_SOURCES[error_source], self.plausible.get(error_source)
            typical = info.typical if stated is None else stated
            if error_source == "waviness":
                for k in self.powers:
                    unit = "mm/rad" if k == 1 else f"mm/rad^{k}"
                    # Over a short sweep, a wave of the usual height would be steeper than an edge can be.
                    size = (
                        typical
                        if stated is not None
                        else min(typical, MAX_WAVINESS_SLOPE_RAD * self.nose * self.reach[0] / k)
                    )
                    if stated is None and k > 1:  # the local radius cannot change so much that the nose is flat
                        size = min(size, RADIUS_CHANGE_RATIO * self.nose * self.reach[0] ** 2 / (k * (k - 1)))
                    columns.append(Column(f"waviness c{k}", error_source, unit, size / self.reach[0] ** k, k))
            elif error_source == "straightness":
                inner = self.knots[1:-1]
                columns += [Column(f"straightness at {at:.4g} mm", error_source, "mm", typical, 0) for at in inner]
            elif error_source in LOBES:
                columns += [Column(f"{error_source} {part}", error_source, "mm", typical, 0) for part in ("cos", "sin")]
            else:
                if error_source == "radius error" and stated is None:
                    typical = min(typical, RADIUS_ERROR_RATIO * self.nose)
                columns.append(Column(error_source, error_source, info.unit, typical, 0))
        return columns

    def deviations(self, values: Floats) -> Deviations:
        """Return the deviations of tool and machine for some values. (k,) in."""
        of: dict[str, Floats] = {}
        for column, value in zip(self.all, values, strict=True):
            of[column.error_source] = np.append(of.get(column.error_source, np.zeros(0)), value)

        def one(name: str) -> float:
            return float(of[name][0]) if name in of else 0.0

        return Deviations(
            offset=(one("offset x"), one("offset y"), one("offset z")),
            radius=one("radius error"),
            powers=self.powers,
            waviness=of.get("waviness", np.zeros(0)),
            squareness=one("squareness"),
            knots=self.knots if "straightness" in of else np.zeros(0),
            straightness=np.pad(of["straightness"], 1) if "straightness" in of else np.zeros(0),
            late=one("servo lag"),
            stiff=one("servo amplitude"),
        )

    def added(self, x: Floats, y: Floats, cutting: Callable[[], Cutting]) -> dict[str, Floats]:
        """Return the signatures that add in proportion, by source; ``cutting`` is called if needed. (k, n) each."""
        marks: dict[str, Floats] = {}
        for error_source in self.error_sources:
            if isinstance(error_source, ErrorSource):
                cut = cutting()
                mark = np.asarray(error_source.signature(cut), dtype=np.float64)
                if mark.shape != x.shape or not np.isfinite(mark[np.isfinite(cut.z)]).all():
                    raise InputError(
                        f"the signature of {error_source.name!r} has the shape {mark.shape} or is not finite, it "
                        f"must return a finite height for each of {x.size} points"
                    )
                marks[error_source.name] = mark[None]
            elif error_source in LOBES:
                wave = ((x + 1j * y) / self.reach[1]) ** LOBES[error_source]
                marks[error_source] = np.stack([wave.real, wave.imag])
        return marks

    def slopes(self, cutting: Cutting, added: Mapping[str, Floats], sense: int, cusp: float) -> Floats:
        """Return the derivative of the height by each unknown, with cusps of ``cusp`` per curvature [mm²].

        (n, k).
        """
        rows: list[Floats] = []
        for error_source in self.error_sources:
            name = error_source if isinstance(error_source, str) else error_source.name
            if name in added:
                rows += list(added[name])
            elif name.startswith("offset"):
                rows.append(cutting.by_tip["xyz".index(name[-1])])
            elif name == "radius error":
                rows.append(cutting.by_radius + cusp * cutting.between_by[0])
            elif name == "waviness":
                waves = raise_sweep(np.nan_to_num(cutting.sweep), self.powers)
                rows += list(waves[0] * cutting.by_edge + cusp * (waves * cutting.between_by[:, None]).sum(axis=0))
            elif name == "squareness":
                rows.append(cutting.tip_radius)
            elif name == "straightness":
                hats = np.eye(self.knots.size)[1:-1]
                rows += [np.interp(cutting.tip_radius, self.knots, hat) for hat in hats]
            elif name == "servo lag":
                rows.append(-sense * cutting.by_azimuth)
            else:
                rows.append(-cutting.bend)
        return np.stack(rows, axis=1) if rows else np.zeros((cutting.x.size, 0))
