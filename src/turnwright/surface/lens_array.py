"""Lenslet arrays: each point belongs to the lenslet with the nearest centre."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright._kernels import cells
from turnwright._validate import check_numbers, finite_tuple, instance_of, positive, whole_number
from turnwright.errors import InputError
from turnwright.surface.base import Lenslets, Surface
from turnwright.surface.conic import Plane, prescription
from turnwright.units import Count, Length, Natural, Size, write

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import ArrayLike, NDArray
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema
    from scipy.spatial import cKDTree

__all__ = ["LensArray"]

MAX_LENSES = 1_000_000
"""Lenses of an array; more come from a wrong unit."""

FARTHEST_MM = 1e100
"""Distance beyond which the nearest lens is looked for as if the point were there."""

NEAR = 0.499
"""Share of the smallest distance of two centres within which there is no nearer one, whatever rounds."""


class _Bins(NamedTuple):
    """Square bins of the plane, each with the centres that may be nearest to its points. See `_kernels.cells`."""

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
"""Fields that define the centres of each layout; the first one is required."""


class _Centres:
    """Annotation of centres: pairs of lengths in a job file."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        def written(centres: Floats | None) -> Any:
            return None if centres is None else [[write(float(at), "mm") for at in centre] for centre in centres]

        pairs = handler.generate_schema(tuple[tuple[Length, Length], ...])
        return core_schema.no_info_after_validator_function(
            lambda centres: np.array(centres, dtype=np.float64).reshape(-1, 2), pairs,
            serialization=core_schema.plain_serializer_function_ser_schema(written),
        )  # fmt: skip


class _Surround:
    """Annotation of a surround: any surface in a job file; a height is written as a plane."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only job files need pydantic

        from turnwright.surface.tables import table_of  # noqa: PLC0415 - likewise

        def written(around: Surface | float | None) -> Any:
            if around is None:
                return None
            return table_of(around if isinstance(around, Surface) else Plane().placed(shift=(0.0, 0.0, around)))

        return core_schema.nullable_schema(
            handler.generate_schema(Surface), serialization=core_schema.plain_serializer_function_ser_schema(written)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensArray(Surface):
    """An array of equal lenslets, one at each centre.

    Every point of the plane belongs to the nearest centre, or the first of several, so the outermost cells are
    unbounded; between neighbours there is a sharp valley or ridge. With an ``aperture`` the lenslets are round instead,
    and the ``surround`` is the surface outside all of them.

    Make regular arrays with `LensArray.square` and `LensArray.hexagonal`. For lenslets on a curved base add the base;
    turn or move an array with ``placed``.

    Parameters
    ----------
    lenslet
        The surface of one lenslet, about its own origin.
    centres
        Centres of listed lenslets; derived for other layouts. (n, 2) [mm]
    layout
        Arrangement of the lenslets: "square", "hexagonal" or "listed".
    pitch
        Distance between neighbours. [mm]
    rows, columns
        Numbers of rows and columns of a square array; its middle is at ``offset``.
    rings
        Number n of rings around the lenslet at ``offset`` of a hexagonal array: 3 n (n + 1) + 1 lenslets.
    within
        Radius of a circle about the axis: a lenslet is included if its circle of radius ``aperture``, by default half
        the pitch, lies inside. One lenslet is at ``offset``; half a pitch along x and y puts a corner on the axis. [mm]
    offset
        Position of the array; on the axis by default. [mm]
    aperture
        Semi-diameter of every lenslet, or ``None`` where lenslets fill their cells. [mm]
    surround
        The surface outside the apertures, in the frame of the array, or a height [mm]. Only with ``aperture``.

    Raises
    ------
    InputError
        If there is no centre, two coincide, apertures overlap, or only one of ``aperture`` and ``surround`` is given.

    Notes
    -----
    `piece` is the index of the nearest centre, and n for the surround. Cells are convex; a surround is not.

    Sources
    -------
    [Li2018]_ Table 4 (2 x 2). [Kong2019]_ has 7 x 7 lenses at 2 mm on a part of 15 mm; only 37 of them are complete.
    The centre is looked up exactly because of its errata and those of the nearest-lens rule in [Zhu2019]_ Eqs 4-5.

    >>> from turnwright.surface.expression import Expression
    >>> lenslet = Expression("(x**2 + y**2) / 20")
    >>> LensArray.square(pitch=2.0, lenslet=lenslet, within=7.5).centres.shape   # Kong's part
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
    centres: Annotated[Floats, _Centres] = None  # type: ignore[assignment] # None until derived from the layout
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
        if centres.shape[1] != 2 or not 1 <= centres.shape[0] <= MAX_LENSES:
            raise InputError(
                f"centres of a lens array have the shape {centres.shape}, it must be (n, 2) with n from 1 to "
                f"{MAX_LENSES}: give x and y of each lens in a row"
            )
        instance_of(self.lenslet, Surface, "the lenslet")
        tree = cKDTree(centres)
        spacing = float("inf")
        if centres.shape[0] > 1:
            distance, index = (np.asarray(part) for part in tree.query(centres, k=2))
            closest = int(np.argmin(distance[:, 1]))
            spacing = float(distance[closest, 1])
            if spacing <= 1e-9 * np.abs(centres).max():
                at = f"{centres[closest, 0]:g}, {centres[closest, 1]:g}"
                # For coincident centres the tree may return a lens itself as the second nearest.
                first, second = sorted({closest, *index[closest].tolist()})[:2]
                raise InputError(
                    f"lenses {first + 1} and {second + 1}, counted from 1, are both at ({at}) mm, only one is allowed: "
                    "remove one"
                )
        if (self.aperture is None) != (self.surround is None):
            raise InputError(
                f"aperture is {self.aperture} and surround is {self.surround}, they must be given together: "
                "give the surface around the lenslets, or remove the aperture"
            )
        if self.aperture is not None:
            positive(self.aperture, "aperture of a lenslet", "mm")
            if self.aperture > spacing / 2 * (1 + 1e-12):
                raise InputError(
                    f"aperture of a lenslet is {self.aperture:g} mm, the limit is half the smallest distance between "
                    f"centres, {spacing / 2:g} mm: reduce it, or remove it so that lenslets fill their cells"
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
        """Return an array on a square lattice: of rows and columns, or of all lenses ``within`` a circle.

        Raises
        ------
        InputError
            Unless either rows and columns or within are given, or if no lens fits.
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
        """Return an array on a hexagonal lattice with rows along x: of rings, or of all lenses ``within`` a circle.

        Raises
        ------
        InputError
            Unless either rings or within is given, or if no lens fits.
        """
        return cls(
            layout="hexagonal", pitch=pitch, rings=rings, within=within, offset=offset, lenslet=lenslet,
            aperture=aperture, surround=surround,
        )  # fmt: skip

    def _laid_out(self) -> Floats:
        """Return the listed centres, or those of the layout. (n, 2)."""
        allowed = _LAYOUTS[self.layout]
        for name in ("pitch", "rows", "columns", "rings", "within", "offset"):
            if getattr(self, name) is not None and name not in allowed:
                raise InputError(
                    f"{name} is not allowed in the layout {self.layout!r}, which allows {', '.join(allowed)}: remove it"
                )
        if getattr(self, allowed[0]) is None:
            raise InputError(f"the layout {self.layout!r} needs {allowed[0]}, which is missing: add it")
        if self.layout == "listed":
            return frozen(self.centres, "centres of a lens array", ndim=2)
        pitch = positive(self.pitch or 0.0, "pitch of a lens array", "mm")
        at = finite_tuple(self.offset or (0.0, 0.0), "offset of a lens array", 2)
        centres = (_square if self.layout == "square" else _hexagonal)(self, pitch, at)
        if self.centres is not None and not np.array_equal(self.centres, centres):
            raise InputError(
                f'centres differ from those of the layout {self.layout!r}: use the layout "listed", or remove centres'
            )
        return frozen(centres, "centres of a lens array", ndim=2)

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with a surround that is a height replaced by a plane."""
        if isinstance(table.get("surround"), str):
            height = {"family": "plane", "placed": {"shift": ["0 mm", "0 mm", table["surround"]]}}
            table = {**table, "surround": height}
        return table

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with the layout, which a job file must have."""
        return {"layout": self.layout, **table}

    @property
    def unstated(self) -> Collection[str]:
        """The centres, where the layout defines them."""
        return () if self.layout == "listed" else ("centres",)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives; on a border, of one side. See `Surface.evaluate`."""
        return self._evaluate(self._cell(x, y), x, y, order)

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the lenslet, or the surround, is defined."""
        return self._inside(self._cell(x, y), x, y)

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, Ints | None]:
        """Return the height, nan outside the domain, and the piece. See `Surface.sample`."""
        cell = self._cell(x, y)
        (z,), inside = self._evaluate(cell, x, y, 0), self._inside(cell, x, y)
        if inside is not None:
            z[~inside] = np.nan
        return z, cell[0].reshape(x.shape)

    def _evaluate(self, cell: tuple[Ints, Floats, Floats], x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        index, u, v = cell
        parts = self.lenslet.evaluate(u, v, order)
        if self.surround is not None:
            outside = np.flatnonzero(index == self.centres.shape[0])
            around: Sequence[Floats | float]
            if isinstance(self.surround, Surface):
                around = self.surround.evaluate(x.ravel()[outside], y.ravel()[outside], order)
            else:
                around = (float(self.surround), *[0.0] * (len(parts) - 1))
            for part, value in zip(parts, around, strict=True):
                part[outside] = value
        return tuple(part.reshape(x.shape) for part in parts)

    def _inside(self, cell: tuple[Ints, Floats, Floats], x: Floats, y: Floats) -> Bools | None:
        index, u, v = cell
        lens = self.lenslet.inside(u, v)
        around = self.surround.inside(x.ravel(), y.ravel()) if isinstance(self.surround, Surface) else None
        if lens is None and around is None:
            return None
        inside = np.where(
            index < self.centres.shape[0], True if lens is None else lens, True if around is None else around
        )
        return inside.reshape(x.shape)

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the poles of the lenslet in each lens, and of the surround outside them. See `Surface.poles`."""
        index, u, v = self._cell(x, y)
        lens = (index < self.centres.shape[0]).reshape(x.shape)
        # Lenses are equal: poles are searched in one, and exist in every lens whose cell contains them.
        u, v = (np.where(lens, part.reshape(x.shape), np.nan) for part in (u, v))
        u, v = self.lenslet.poles(u, v, reach)
        at = (self.centres[:, None] + np.stack([u, v], axis=-1)).reshape(-1, 2)
        in_cell = self._cell(*at.T)[0] == np.repeat(np.arange(self.centres.shape[0]), u.size)
        pole_x, pole_y = at[in_cell].T
        if isinstance(self.surround, Surface):
            u, v = self.surround.poles(np.where(lens, np.nan, x), np.where(lens, np.nan, y), reach)
            between = self._cell(u, v)[0] == self.centres.shape[0]
            pole_x, pole_y = np.append(pole_x, u[between]), np.append(pole_y, v[between])
        return pole_x, pole_y

    @property
    def domain(self) -> str:
        """The domain of the array in words."""
        words = "the whole plane"
        if self.lenslet.domain != words:
            words = f"about the nearest lens centre {self.lenslet.domain}"
        if isinstance(self.surround, Surface) and self.surround.domain != "the whole plane":
            words += f", and between the lenses {self.surround.domain}"
        return words

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the index of the nearest centre, or the number of centres for the surround."""
        return self._cell(x, y)[0].reshape(x.shape)

    def border(self, first: Ints, second: Ints, x: Floats, y: Floats) -> Floats:
        """Return how much the square of the distance from one lens is below that from another. See `Surface.border`.

        For the surround, the square is that of the aperture.
        """
        out = np.empty(x.size)
        square = np.nan if self.aperture is None else self.aperture**2
        cells.border(first, second, x, y, self.centres, square, out)
        return out

    @property
    def lenslets(self) -> Lenslets | None:
        """The lenslets, if they are conics with even powers that fill their cells. See `Surface.lenslets`."""
        lens = None if self.surround is not None else prescription(self.lenslet)
        if lens is None:
            return None
        return Lenslets(np.column_stack([self.centres, np.zeros(self.centres.shape[0])]), *lens)

    @property
    def convex_pieces(self) -> bool:
        """Whether lenslets fill their cells: a surround is not convex."""
        return self.surround is None

    @property
    def feature_size(self) -> float:
        """An eighth of the smallest distance between centres, or less if lenslet or surround are finer. [mm]."""
        around = self.surround.feature_size if isinstance(self.surround, Surface) else float("inf")
        return min(self._spacing / 8, self.lenslet.feature_size, around)

    @property
    def cost(self) -> int:
        """Cost of lenslet and surround, one of which is evaluated at each point. See `Surface.cost`."""
        return max(self.lenslet.cost, self.surround.cost if isinstance(self.surround, Surface) else 0)

    def _cell(self, x: Floats, y: Floats) -> tuple[Ints, Floats, Floats]:
        """Return the piece of each point, and its position relative to the nearest centre. Each (n,)."""
        x, y = x.ravel(), y.ravel()
        index, u, v = np.empty(x.size, dtype=np.int64), np.empty(x.size), np.empty(x.size)
        if cells.nearest(x, y, self.centres, NEAR * self._spacing, *self._bins, index, u, v):
            beyond = np.flatnonzero(index < 0)
            points = np.stack([x[beyond], y[beyond]], axis=-1)
            # A point that is not finite, or too far away to be squared, keeps what it is in u and v.
            centre = self._tree.query(np.clip(np.nan_to_num(points), -FARTHEST_MM, FARTHEST_MM))[1]
            index[beyond] = centre
            u[beyond], v[beyond] = (points - self.centres[centre]).T
        if self.aperture is not None:
            index[u * u + v * v > self.aperture**2] = self.centres.shape[0]
        return index, u, v


def _square(array: LensArray, pitch: float, at: tuple[float, ...]) -> Floats:
    rows, columns, within = array.rows, array.columns, array.within
    if within is not None and rows is None and columns is None:
        return _inside_circle((pitch, 0), (0, pitch), at, within, array.aperture)
    if within is not None or rows is None or columns is None:
        raise InputError(
            f"a square array has rows {rows}, columns {columns} and within {within}, it needs rows and columns, or "
            "within alone: remove the others"
        )
    rows, columns = whole_number(rows, "rows of a lens array", 1), whole_number(columns, "columns of a lens array", 1)
    if rows * columns > MAX_LENSES:
        raise InputError(
            f"a lens array has {rows} rows of {columns} lenses, the limit is {MAX_LENSES} lenses: correct the counts"
        )
    across, along = np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2
    return _lattice(across, along, (pitch, 0), (0, pitch), at)


def _hexagonal(array: LensArray, pitch: float, at: tuple[float, ...]) -> Floats:
    rings, within = array.rings, array.within
    if (rings is None) == (within is None):
        raise InputError(
            f"a hexagonal array has rings {rings} and within {within}, only one of them is allowed: remove the other"
        )
    slanted = ((pitch, 0), (pitch / 2, pitch * np.sqrt(0.75)))
    if within is not None:
        return _inside_circle(*slanted, at, within, array.aperture)
    rings = whole_number(rings, "rings of a lens array", 0, 500)
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
    # A centre that is nearest to a point of a bin is at most a diagonal farther from its middle than the nearest one.
    reach = (tree.query(middles)[0] + np.sqrt(2) * step) * (1 + 1e-9)
    lists = tree.query_ball_point(middles, reach, return_sorted=True)
    first = np.concatenate([[0], np.cumsum([len(candidates) for candidates in lists])])
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


def _inside_circle(
    a: tuple[float, float], b: tuple[float, float], offset: tuple[float, ...], within: float, aperture: float | None
) -> Floats:
    """Return the lattice points offset + i a + j b, a along x, whose lens is inside the circle. (n, 2)."""
    positive(within, "within, the radius that lenses must fit in,", "mm")
    row = b[1]
    # A slanted lattice vector takes up to half as many columns more than rows.
    reach = int(min(1.5 * (within + np.hypot(offset[0], offset[1])) / row, 1e9)) + 1
    if reach**2 > MAX_LENSES:
        raise InputError(
            f"within is {within:g} mm with rows {row:g} mm apart, the limit is {MAX_LENSES} lenses: check the units"
        )
    i = np.arange(-reach, reach + 1)
    centres = _lattice(i, i, a, b, offset)
    lens = a[0] / 2 if aperture is None else aperture
    inside: Floats = centres[np.hypot(*centres.T) + lens <= within * (1 + 1e-12)]
    if inside.shape[0] == 0:
        raise InputError(
            f"no lens of radius {lens:g} mm fits within {within:g} mm: reduce the pitch or enlarge the radius"
        )
    return inside
