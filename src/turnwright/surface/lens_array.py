"""Arrays of lenslets: the nearest centre decides the cell."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright._kernels.cells import nearest
from turnwright._validate import check_numbers, finite_tuple, positive, whole
from turnwright.errors import InputError
from turnwright.surface.base import Surface
from turnwright.surface.conic import Plane
from turnwright.units import Count, Length, Natural, Size, write

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import ArrayLike, NDArray
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema
    from scipy.spatial import cKDTree

__all__ = ["LensArray"]

MOST_LENSES = 1_000_000
"""More than this is a slip of the unit, not an array."""


class _Bins(NamedTuple):
    """Squares of the plane, each with the centres that can be nearest somewhere in it. See `_kernels.cells`."""

    corner: tuple[float, float]
    step: float
    counts: tuple[int, int]
    first: NDArray[np.int64]
    candidates: NDArray[np.int64]


_LAYOUTS = {
    "square": ("pitch", "rows", "columns", "within", "offset"),
    "hexagonal": ("pitch", "rings", "within", "offset"),
    "listed": ("centres",),
}
"""What says where the lenses of each layout stand; the first one must."""


class _Centres:
    """The annotation of centres: pairs of lengths in a job file."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        def written(centres: Floats | None) -> Any:
            return None if centres is None else [[write(float(at), "mm") for at in one] for one in centres]

        pairs = handler.generate_schema(tuple[tuple[Length, Length], ...])
        return core_schema.no_info_after_validator_function(
            lambda centres: np.array(centres, dtype=np.float64).reshape(-1, 2), pairs,
            serialization=core_schema.plain_serializer_function_ser_schema(written),
        )  # fmt: skip


class _Surround:
    """The annotation of a surround: any surface in a job file, and a height as a plane there."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        from turnwright.surface.stated import table_of  # noqa: PLC0415 - likewise

        def written(around: Surface | float | None) -> Any:
            if around is None:
                return None
            return table_of(around if isinstance(around, Surface) else Plane().placed(shift=(0.0, 0.0, around)))

        found = handler.generate_schema(Surface)
        return core_schema.nullable_schema(
            found, serialization=core_schema.plain_serializer_function_ser_schema(written)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensArray(Surface):
    """Equal lenslets, each standing on its own centre.

    Every point of the plane belongs to the nearest centre, on a tie to the first of them, so the outermost cells run
    on without end; where neighbours meet there is a sharp valley or ridge. With an ``aperture`` the lenslets are
    round instead, and what is outside of all of them is the ``surround``.

    Make regular arrays with `LensArray.square` and `LensArray.hexagonal`. For lenslets on a curved base add the base;
    turn or move an array with ``placed``.

    Parameters
    ----------
    lenslet
        The surface of one lenslet, about its own origin.
    centres
        Of listed lenslets, one by one; those of a layout are worked out. (n, 2) [mm]
    layout
        How the lenslets stand.
    pitch
        Distance between neighbours. [mm]
    rows
        Of a square array.
    columns
        Of a square array.
    rings
        Around the lenslet in the middle of a hexagonal array.
    within
        Only lenslets that lie whole within this radius. [mm]
    offset
        Where the middle of the array stands; on the axis if left out. [mm]
    aperture
        Radius of every lenslet, or ``None`` where lenslets fill their cells. [mm]
    surround
        What lies outside the apertures: a surface in the frame of the array, or a height [mm]. Give it
        with ``aperture`` only.

    Raises
    ------
    InputError
        If there is no centre, two coincide, apertures overlap, or only one of ``aperture`` and ``surround`` is given.

    Notes
    -----
    `piece` is the index of the nearest centre, and n for the surround. Cells are convex; a surround is not.

    Sources
    -------
    [Li2018]_ Table 4 (2 x 2). [Kong2019]_ has 7 x 7 lenses at 2 mm on a part of 15 mm; only 37 of them are whole. Its
    errata and those of the nearest-lens rule in [Zhu2019]_ Eqs 4-5 are why the centre is looked up exactly.

    >>> from turnwright.surface.expression import Expression
    >>> bowl = Expression("(x**2 + y**2) / 20")
    >>> LensArray.square(pitch=2.0, lenslet=bowl, within=7.5).centres.shape   # Kong's part
    (37, 2)
    """

    family = "lens array"
    example = MappingProxyType(
        {
            "layout": "square",
            "pitch": "1 mm",
            "rows": 3,
            "columns": 3,
            "lenslet": {"family": "sphere", "radius": "5 mm"},
        }
    )
    needed = ("layout",)
    lenslet: Surface
    centres: Annotated[Floats, _Centres] = None  # type: ignore[assignment] # None asks for those of a layout
    layout: Literal["square", "hexagonal", "listed"] = "listed"
    pitch: Size | None = None
    rows: Count | None = None
    columns: Count | None = None
    rings: Natural | None = None
    within: Size | None = None
    offset: tuple[Length, Length] | None = None
    aperture: Size | None = None
    surround: Annotated[Surface | float | None, _Surround] = None
    _spacing: float = field(init=False, repr=False)
    _tree: cKDTree = field(init=False, repr=False)
    _bins: _Bins = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is costly to import

        centres = self._laid_out()
        if centres.shape[1] != 2 or not 1 <= centres.shape[0] <= MOST_LENSES:
            raise InputError(
                f"centres of a lens array have the shape {centres.shape}, it must be (n, 2) with n from 1 to "
                f"{MOST_LENSES}: give x and y of each lens in a row"
            )
        if not isinstance(self.lenslet, Surface):
            raise InputError(f"the lenslet is {self.lenslet!r}, which is not a surface: give a Surface")
        tree = cKDTree(centres)
        spacing = float("inf")
        if centres.shape[0] > 1:
            distance, index = (np.asarray(part) for part in tree.query(centres, k=2))
            closest = int(np.argmin(distance[:, 1]))
            spacing = float(distance[closest, 1])
            if spacing <= 1e-9 * np.abs(centres).max():
                at = f"{centres[closest, 0]:g}, {centres[closest, 1]:g}"
                # On one place the tree may name a lens itself second.
                first, second = sorted({closest, *index[closest].tolist()})[:2]
                raise InputError(
                    f"lenses {first + 1} and {second + 1}, counted from 1, both stand at ({at}) mm, the limit is one "
                    "on a place: remove one"
                )
        if (self.aperture is None) != (self.surround is None):
            raise InputError(
                f"aperture is {self.aperture} and surround is {self.surround}, it takes both or neither: "
                "say what lies outside the round lenslets, or leave out the aperture"
            )
        if self.aperture is not None:
            positive(self.aperture, "aperture of a lenslet", "mm")
            if self.aperture > spacing / 2 * (1 + 1e-12):
                raise InputError(
                    f"aperture of a lenslet is {self.aperture:g} mm, the limit is half the least distance of two "
                    f"centres, {spacing / 2:g} mm: reduce it, or leave it out to let lenslets meet"
                )
        for name, value in (
            ("centres", centres),
            ("_spacing", spacing),
            ("_tree", tree),
            ("_bins", _bin(centres, tree)),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def square(
        cls,
        *,
        pitch: float,
        lenslet: Surface,
        rows: int | None = None,
        columns: int | None = None,
        within: float | None = None,
        offset: tuple[float, float] | None = None,
        aperture: float | None = None,
        surround: Surface | float | None = None,
    ) -> Self:
        """Return an array on a square lattice: so many rows and columns, or all lenses that fit whole in a circle.

        Parameters
        ----------
        pitch
            Distance of neighbouring centres along x and y. [mm]
        rows, columns
            How many; the middle of the array is at ``offset``.
        within
            Radius of a circle about the axis; a lens is in if its round part, of the radius ``aperture`` or else half
            the pitch, is. One lens stands at ``offset``; half a pitch each way puts a corner there. [mm]
        offset
            Where the array stands. [mm]
        lenslet, aperture, surround
            See `LensArray`.

        Raises
        ------
        InputError
            Unless it is either rows and columns, or within; if no lens fits.
        """
        return cls(
            layout="square", pitch=pitch, rows=rows, columns=columns, within=within, offset=offset, lenslet=lenslet,
            aperture=aperture, surround=surround,
        )  # fmt: skip

    @classmethod
    def hexagonal(
        cls,
        *,
        pitch: float,
        lenslet: Surface,
        rings: int | None = None,
        within: float | None = None,
        offset: tuple[float, float] | None = None,
        aperture: float | None = None,
        surround: Surface | float | None = None,
    ) -> Self:
        """Return an array on a hexagonal lattice with rows along x: so many rings, or all that fit whole in a circle.

        Parameters
        ----------
        pitch
            Distance of neighbouring centres. [mm]
        rings
            How many rings of lenses stand around the one at ``offset``: 3 n (n + 1) + 1 lenses.
        within, offset, lenslet, aperture, surround
            See `square`.

        Raises
        ------
        InputError
            Unless it is either rings or within; if no lens fits.
        """
        return cls(
            layout="hexagonal", pitch=pitch, rings=rings, within=within, offset=offset, lenslet=lenslet,
            aperture=aperture, surround=surround,
        )  # fmt: skip

    def _laid_out(self) -> Floats:
        """Return the centres that are listed, or that the layout has. (n, 2)."""
        used = _LAYOUTS[self.layout]
        for name in ("pitch", "rows", "columns", "rings", "within", "offset"):
            if getattr(self, name) is not None and name not in used:
                raise InputError(
                    f"{name} does not go with the layout {self.layout!r}, which takes {', '.join(used)}: remove it"
                )
        if getattr(self, used[0]) is None:
            raise InputError(f"the layout {self.layout!r} needs {used[0]}, which is missing: add it")
        if self.layout == "listed":
            return frozen(self.centres, "centres of a lens array", ndim=2)
        pitch = positive(self.pitch or 0.0, "pitch of a lens array", "mm")
        at = finite_tuple(self.offset or (0.0, 0.0), "offset of a lens array", 2)
        found = (_square if self.layout == "square" else _hexagonal)(self, pitch, at)
        if self.centres is not None and not np.array_equal(self.centres, found):
            raise InputError(
                f"centres are not those of the layout {self.layout!r}, only one of them can hold: list them with the "
                'layout "listed", or leave them out'
            )
        return frozen(found, "centres of a lens array", ndim=2)

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with its layout, which a job file must state, and a surround that is a height as a plane."""
        if isinstance(table.get("surround"), str):
            height = {"family": "plane", "placed": {"shift": ["0 mm", "0 mm", table["surround"]]}}
            table = {**table, "surround": height}
        return table

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the fields with the layout, which a job file must state."""
        return {"layout": self.layout, **table}

    @property
    def unstated(self) -> Collection[str]:
        """The centres, where the layout says them."""
        return () if self.layout == "listed" else ("centres",)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives, on a border those of one side. See `Surface.evaluate`."""
        index, u, v = self._cell(x, y)
        parts = self.lenslet.evaluate(u, v, order)
        if self.surround is not None:
            outside = np.flatnonzero(index == self.centres.shape[0])
            around: Sequence[Floats | float]
            if isinstance(self.surround, Surface):
                around = self.surround.evaluate(x.ravel()[outside], y.ravel()[outside], order)
            else:
                around = (float(self.surround), *[0.0] * (len(parts) - 1))
            for part, there in zip(parts, around, strict=True):
                part[outside] = there
        return tuple(part.reshape(x.shape) for part in parts)

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the lenslet, or the surround, is defined."""
        index, u, v = self._cell(x, y)
        lens = self.lenslet.inside(u, v)
        around = self.surround.inside(x.ravel(), y.ravel()) if isinstance(self.surround, Surface) else None
        if lens is None and around is None:
            return None
        there = np.where(
            index < self.centres.shape[0], True if lens is None else lens, True if around is None else around
        )
        return there.reshape(x.shape)

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the poles of the lenslet in each lens, and of the surround outside them. See `Surface.poles`."""
        index, u, v = self._cell(x, y)
        lens = (index < self.centres.shape[0]).reshape(x.shape)
        # All lenses are alike: poles are looked for in one, and are there wherever they fall in a lens's own cell.
        u, v = (np.where(lens, part.reshape(x.shape), np.nan) for part in (u, v))
        u, v = self.lenslet.poles(u, v, reach)
        at = (self.centres[:, None] + np.stack([u, v], axis=-1)).reshape(-1, 2)
        own = self._cell(*at.T)[0] == np.repeat(np.arange(self.centres.shape[0]), u.size)
        pole_x, pole_y = at[own].T
        if isinstance(self.surround, Surface):
            u, v = self.surround.poles(np.where(lens, np.nan, x), np.where(lens, np.nan, y), reach)
            between = self._cell(u, v)[0] == self.centres.shape[0]
            pole_x, pole_y = np.append(pole_x, u[between]), np.append(pole_y, v[between])
        return pole_x, pole_y

    @property
    def domain(self) -> str:
        """Say in words where the array is defined."""
        words = "the whole plane"
        if self.lenslet.domain != words:
            words = f"about the nearest lens centre {self.lenslet.domain}"
        if isinstance(self.surround, Surface) and self.surround.domain != "the whole plane":
            words += f", and between the lenses {self.surround.domain}"
        return words

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the index of the nearest centre, or the number of centres for the surround."""
        return self._cell(x, y)[0].reshape(x.shape)

    @property
    def feature_size(self) -> float:
        """An eighth of the least distance of two centres, or finer where a lenslet or the surround is. [mm]."""
        around = self.surround.feature_size if isinstance(self.surround, Surface) else float("inf")
        return min(self._spacing / 8, self.lenslet.feature_size, around)

    def _cell(self, x: Floats, y: Floats) -> tuple[Ints, Floats, Floats]:
        """Return each point's piece, and where it is from the nearest centre. Each (n,)."""
        x, y = x.ravel(), y.ravel()
        index, u, v = np.empty(x.size, dtype=np.int64), np.empty(x.size), np.empty(x.size)
        nearest(x, y, self.centres, *self._bins, index, u, v)
        beyond = np.flatnonzero(index < 0)
        if beyond.size:
            points = np.stack([x[beyond], y[beyond]], axis=-1)
            # A point that is not finite is nearest to nothing; it keeps its nan in u and v.
            found = self._tree.query(np.nan_to_num(points))[1]
            index[beyond] = found
            u[beyond], v[beyond] = (points - self.centres[found]).T
        if self.aperture is not None:
            index[u * u + v * v > self.aperture**2] = self.centres.shape[0]
        return index, u, v


def _square(array: LensArray, pitch: float, at: tuple[float, ...]) -> Floats:
    """Return the centres of a square lattice. (n, 2)."""
    rows, columns, within = array.rows, array.columns, array.within
    if within is not None and rows is None and columns is None:
        return _whole((pitch, 0), (0, pitch), at, within, array.aperture)
    if within is not None or rows is None or columns is None:
        raise InputError(
            f"a square array has rows {rows}, columns {columns} and within {within}, it takes rows and columns, or "
            "within alone: leave out the others"
        )
    rows, columns = whole(rows, "rows of a lens array", 1), whole(columns, "columns of a lens array", 1)
    if rows * columns > MOST_LENSES:
        raise InputError(
            f"a lens array has {rows} rows of {columns}, the limits are 1 of each and {MOST_LENSES} lenses: "
            "correct the counts"
        )
    across, along = np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2
    return _lattice(across, along, (pitch, 0), (0, pitch), at)


def _hexagonal(array: LensArray, pitch: float, at: tuple[float, ...]) -> Floats:
    """Return the centres of a hexagonal lattice with rows along x. (n, 2)."""
    rings, within = array.rings, array.within
    if (rings is None) == (within is None):
        raise InputError(
            f"a hexagonal array has rings {rings} and within {within}, it takes one of them: leave out the other"
        )
    slanted = ((pitch, 0), (pitch / 2, pitch * np.sqrt(0.75)))
    if within is not None:
        return _whole(*slanted, at, within, array.aperture)
    rings = whole(rings, "rings of a lens array", 0, 500)
    i = np.arange(-rings, rings + 1)
    first, second = (part.ravel() for part in np.meshgrid(i, i))
    return np.asarray(_lattice(i, i, *slanted, at)[np.abs(first + second) <= rings])


def _bin(centres: Floats, tree: cKDTree) -> _Bins:
    """Cover the centres with about four bins for each, and find the candidates of every bin."""
    low, high = centres.min(axis=0), centres.max(axis=0)
    n = centres.shape[0]
    width, height = high - low
    step = max(np.sqrt(width * height / (4 * n)), max(width, height) / (4 * n)) or 1.0
    corner = low - 4 * step
    counts = np.ceil((high + 4 * step - corner) / step).astype(int)
    middles = np.stack(np.meshgrid(*(corner[k] + (np.arange(counts[k]) + 0.5) * step for k in (0, 1))), axis=-1)
    middles = middles.reshape(-1, 2)
    # A centre nearest to some point of a bin is at most a diagonal farther from its middle than the nearest one is.
    reach = (tree.query(middles)[0] + np.sqrt(2) * step) * (1 + 1e-9)
    lists = tree.query_ball_point(middles, reach, return_sorted=True)
    first = np.concatenate([[0], np.cumsum([len(found) for found in lists])])
    return _Bins(
        corner=(float(corner[0]), float(corner[1])),
        step=float(step),
        counts=(int(counts[0]), int(counts[1])),
        first=first.astype(np.int64),
        candidates=np.concatenate(lists).astype(np.int64),
    )


def _lattice(i: ArrayLike, j: ArrayLike, a: ArrayLike, b: ArrayLike, offset: tuple[float, ...]) -> Floats:
    """Return the points offset + i a + j b, i running fastest. (n, 2)."""
    first, second = (part.reshape(-1, 1) for part in np.meshgrid(i, j))
    return np.asarray(first * np.asarray(a) + second * np.asarray(b) + np.asarray(offset), dtype=np.float64)


def _whole(
    a: tuple[float, float], b: tuple[float, float], offset: tuple[float, ...], within: float, aperture: float | None
) -> Floats:
    """Return the lattice points offset + i a + j b, a along x, whose lens is wholly in the circle. (n, 2)."""
    positive(within, "within, the radius that lenses must fit in,", "mm")
    row = b[1]
    # A slanted lattice vector takes up to half as many columns more than rows.
    reach = int(min(1.5 * (within + np.hypot(offset[0], offset[1])) / row, 1e9)) + 1
    if reach**2 > MOST_LENSES:
        raise InputError(
            f"within is {within:g} mm at {row:g} mm from row to row, that is more than {MOST_LENSES} lenses: "
            "check the units"
        )
    i = np.arange(-reach, reach + 1)
    centres = _lattice(i, i, a, b, offset)
    lens = a[0] / 2 if aperture is None else aperture
    kept: Floats = centres[np.hypot(*centres.T) + lens <= within * (1 + 1e-12)]
    if kept.shape[0] == 0:
        raise InputError(
            f"no lens of radius {lens:g} mm is whole within {within:g} mm: reduce the pitch or enlarge the radius"
        )
    return kept
