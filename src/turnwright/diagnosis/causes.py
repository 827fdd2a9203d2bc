"""What may have gone wrong, and the mark that each leaves on the part."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import check_numbers, positive
from turnwright.diagnosis.model import Cutting, Deviations, Powers, Splines
from turnwright.errors import InputError

__all__ = ["CAUSES", "DEFAULT", "Cause", "Column", "Columns", "Known"]


class Known(NamedTuple):
    """What is known of a cause beforehand."""

    unit: str
    typical: float  # how large it plausibly is, one standard deviation, in its unit
    where: str  # where to look when nothing in the map tells it apart
    mount: bool = False  # made by the mount, not by the cut


CAUSES: Mapping[str, Known] = MappingProxyType(
    {
        "offset x": Known("mm", 0.05, "cut an artefact with slopes, such as a concave sphere"),
        "offset y": Known("mm", 0.05, "cut a tilted flat, or look at the defect at the centre"),
        "offset z": Known("mm", 0.05, "measure the height from a reference, and leave the piston out of what is free"),
        "radius error": Known("mm", 0.02, "cut a sphere and measure its radius as well as its form"),
        "waviness": Known("mm/rad^k", 0.005, "cut an artefact whose slopes use more of the nose"),
        "squareness": Known("rad", 1e-4, "cut an artefact with another slope, such as a flat"),
        "straightness": Known("mm", 0.002, "cut a flat"),
        "servo lag": Known("rad", 0.02, "put a fiducial on the part, and leave the clocking out of what is free"),
        "servo amplitude": Known("rad^2", 1e-3, "cut a part whose height changes more often in a turn"),
        "astigmatism": Known("mm", 0.005, "measure the part again, turned in its mount", mount=True),
        "trefoil": Known("mm", 0.005, "measure the part again, turned in its mount", mount=True),
    }
)  # fmt: skip
"""Every cause that has a name."""

DEFAULT = (
    "offset x",
    "offset y",
    "radius error",
    "waviness",
    "squareness",
    "servo lag",
)
"""Those that are looked for if nobody says otherwise. A bent mount looks like low form, which always is looked for."""

STEEP = 0.02
"""Slope of the waviness against the nose that is plausible. [rad]"""

MISMEASURED = 0.03
"""Error of the nose radius that is plausible, as a share of it."""

BENT = 0.1
"""Change of the nose's own radius by a wave that is plausible, as a share of it: near 1 it would have a flat."""

HARMONIC = MappingProxyType({"astigmatism": 2, "trefoil": 3})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """A cause of one's own: a mark that adds to the height in proportion.

    Parameters
    ----------
    name
        What the shop calls it.
    signature
        From how the points were cut by the planned tool (the fields x, y, tip_radius, tip_angle, sweep, z, zx, zy, each
        (n,) in mm and rad) to the height that one unit of the cause adds there. (n,) [mm per unit]
    typical
        How large it plausibly is, one standard deviation. [unit]
    unit
        Of the value.

    Raises
    ------
    InputError
        If the name is that of a known cause, or ``typical`` is not positive.
    """

    name: str
    signature: Callable[[Cutting], Floats]
    typical: float
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_numbers(self)
        if not self.name or self.name in CAUSES:
            raise InputError(f"a cause of one's own is called {self.name!r}: give it a name that no cause has yet")
        positive(self.typical, f"typical of the cause {self.name!r}", self.unit)


class Column(NamedTuple):
    """One number to be found."""

    name: str
    cause: str
    unit: str
    typical: float
    order: int  # of a power of the sweep, else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """All numbers to be found, and how they make deviations and marks.

    Parameters
    ----------
    causes
        Names, or causes of one's own.
    basis
        Of the waviness.
    knots
        Positions along X of the straightness, which is 0 at both ends: what is straight is squareness. (m,) [mm]
    reach
        Largest sweep used [rad], and radius of the part [mm].
    nose
        Radius of the tool's nose. [mm]
    plausible
        Size of a cause where it is not the usual one, one standard deviation. [unit of the cause]
    """

    causes: Sequence[str | Cause]
    basis: Powers | Splines
    knots: Floats
    reach: tuple[float, float]
    nose: float
    plausible: Mapping[str, float]

    @property
    def all(self) -> list[Column]:
        """One column for each number."""
        columns: list[Column] = []
        for cause in self.causes:
            if isinstance(cause, Cause):
                columns.append(Column(cause.name, cause.name, cause.unit, cause.typical, 0))
                continue
            known, stated = CAUSES[cause], self.plausible.get(cause)
            typical = known.typical if stated is None else stated
            if cause == "waviness" and isinstance(self.basis, Powers):
                for k in self.basis.powers:
                    unit = "mm/rad" if k == 1 else f"mm/rad^{k}"
                    # Over a short sweep a wave as high as elsewhere would be steeper than an edge can be.
                    size = typical if stated is not None else min(typical, STEEP * self.nose * self.reach[0] / k)
                    if stated is None and k > 1:  # nor can it bend so much that the nose is no longer round
                        size = min(size, BENT * self.nose * self.reach[0] ** 2 / (k * (k - 1)))
                    columns.append(Column(f"waviness c{k}", cause, unit, size / self.reach[0] ** k, k))
            elif cause == "waviness":
                columns += [Column(f"waviness b{k + 1}", cause, "mm", typical, 0) for k in range(self.basis.count)]
            elif cause == "straightness":
                inner = self.knots[1:-1]
                columns += [Column(f"straightness at {at:.4g} mm", cause, "mm", typical, 0) for at in inner]
            elif cause in HARMONIC:
                columns += [Column(f"{cause} {part}", cause, "mm", typical, 0) for part in ("cos", "sin")]
            else:
                if cause == "radius error" and stated is None:
                    typical = min(typical, MISMEASURED * self.nose)
                columns.append(Column(cause, cause, known.unit, typical, 0))
        return columns

    def deviations(self, values: Floats) -> Deviations:
        """Return what the numbers make of the tool and the machine. (k,) in."""
        of: dict[str, Floats] = {}
        for column, value in zip(self.all, values, strict=True):
            of[column.cause] = np.append(of.get(column.cause, np.zeros(0)), value)

        def one(name: str) -> float:
            return float(of[name][0]) if name in of else 0.0

        return Deviations(
            offset=(one("offset x"), one("offset y"), one("offset z")),
            radius=one("radius error"),
            basis=self.basis,
            waviness=of.get("waviness", np.zeros(0)),
            squareness=one("squareness"),
            knots=self.knots if "straightness" in of else np.zeros(0),
            straightness=np.pad(of["straightness"], 1) if "straightness" in of else np.zeros(0),
            late=one("servo lag"),
            stiff=one("servo amplitude"),
        )

    def added(self, x: Floats, y: Floats, cutting: Callable[[], Cutting]) -> dict[str, Floats]:
        """Return the marks that add in proportion, by cause; ``cutting`` is asked only if needed. Each (k, n)."""
        marks: dict[str, Floats] = {}
        for cause in self.causes:
            if isinstance(cause, Cause):
                cut = cutting()
                mark = np.asarray(cause.signature(cut), dtype=np.float64)
                if mark.shape != x.shape or not np.isfinite(mark[np.isfinite(cut.z)]).all():
                    raise InputError(
                        f"the signature of the cause {cause.name!r} has the shape {mark.shape} or is not finite, it "
                        f"needs a finite height for each of {x.size} points: correct it"
                    )
                marks[cause.name] = mark[None]
            elif cause in HARMONIC:
                wave = ((x + 1j * y) / self.reach[1]) ** HARMONIC[cause]
                marks[cause] = np.stack([wave.real, wave.imag])
        return marks

    def slopes(self, cutting: Cutting, added: Mapping[str, Floats], sense: int, cusp: float) -> Floats:
        """Return the derivative of the height by each number, that of cusps of ``cusp`` per curvature [mm²] included.

        (n, k).
        """
        rows: list[Floats] = []
        for cause in self.causes:
            name = cause if isinstance(cause, str) else cause.name
            if name in added:
                rows += list(added[name])
            elif name.startswith("offset"):
                rows.append(cutting.by_tip["xyz".index(name[-1])])
            elif name == "radius error":
                rows.append(cutting.by_radius + cusp * cutting.between_by[0])
            elif name == "waviness":
                waves = self.basis.values(np.nan_to_num(cutting.sweep))
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
