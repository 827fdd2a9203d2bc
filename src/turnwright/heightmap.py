"""Height maps: nominal, simulated or measured heights, or differences of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Compared, Floats, block_rows, frozen
from turnwright._validate import check_azimuths, check_numbers, positive, whole_number
from turnwright.errors import DomainError, InputError
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from xarray import DataArray

    from turnwright.pose import Pose
    from turnwright.surface import Surface

__all__ = ["HeightMap"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightMap(Compared):
    """Heights over a rectangular grid (``x``, ``y``), over a polar one (``radius``, ``angle``), or at scattered points.

    Parameters
    ----------
    z
        Heights; nan is a missing point. (ny, nx), (n_angle, n_radius), or (n,) for scattered points [mm]
    x, y
        Ascending columns (nx,) and rows (ny,) of a rectangular grid, or the positions of scattered points (n,). [mm]
    radius, angle
        Columns (n_radius,) [mm] and rows (n_angle,) [rad] of a polar grid.
    name
        Title of the map.
    calibrated
        False where the instrument's file has no pixel size: ``x`` and ``y`` then count pixels, and functions that need
        lengths raise `InputError`. See `scaled`.
    metadata
        Further entries of the instrument's file, as text.

    Raises
    ------
    InputError
        If the axes do not fit the heights or do not ascend, or are neither both rectangular nor both polar.
    """

    z: Floats
    x: Floats | None = None
    y: Floats | None = None
    radius: Floats | None = None
    angle: Floats | None = None
    name: str = ""
    calibrated: bool = True
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self, nan=("z",))
        axes = [name for name in ("x", "y", "radius", "angle") if getattr(self, name) is not None]
        if axes not in (["x", "y"], ["radius", "angle"]):
            raise InputError(
                f"a height map has the axes {', '.join(axes) or 'none'}: give x and y, or radius and angle"
            )
        for name in axes:
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        if self.angle is not None:
            check_azimuths(self.angle, "angle")
        scattered = np.ndim(self.z) == 1 and axes == ["x", "y"]
        object.__setattr__(self, "z", frozen(self.z, "z", ndim=1 if scattered else 2, finite=False))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        for name in () if scattered else axes:
            if not (np.diff(getattr(self, name)) > 0).all():
                raise InputError(f"the {name} of the height map does not ascend: sort it and drop repeated values")
        columns, rows = (getattr(self, name).size for name in axes)
        if scattered and not self.z.size == columns == rows:
            raise InputError(
                f"{self.z.size} scattered heights have {columns} x and {rows} y: give as many of each, or a grid of "
                "heights with rows y and columns x"
            )
        if not scattered and self.z.shape != (rows, columns):
            raise InputError(
                f"z has the shape {self.z.shape}, its axes need {(rows, columns)}: rows are {axes[1]}, columns "
                f"{axes[0]}"
            )

    @property
    def polar(self) -> bool:
        """Whether the grid is polar."""
        return self.radius is not None

    @property
    def scattered(self) -> bool:
        """Whether the heights are at scattered points instead of on a grid."""
        return self.z.ndim == 1

    def points(self, rows: slice = slice(None)) -> tuple[Floats, Floats]:
        """Return x and y of every height, or of those in some rows. Each the shape of ``z`` [mm]."""
        if self.radius is not None and self.angle is not None:
            angle = self.angle[rows, None]
            return np.cos(angle) * self.radius, np.sin(angle) * self.radius
        assert self.x is not None  # noqa: S101 - a map that is not polar has x and y
        assert self.y is not None  # noqa: S101
        if self.scattered:
            return self.x[rows], self.y[rows]
        x, y = np.meshgrid(self.x, self.y[rows])
        return x, y

    def require_calibrated(self) -> None:
        """Raise `InputError` if ``x`` and ``y`` count pixels."""
        if not self.calibrated:
            raise InputError(
                f"the map {self.name!r} of {self.z.shape[-1]} columns has no pixel size, so its lengths are unknown: "
                "give the pixel size where the file is read, pixel_size=..."
            )

    def scaled(self, pixel_size: float | tuple[float, float]) -> HeightMap:
        """Return a map in pixels scaled to lengths.

        Parameters
        ----------
        pixel_size
            Size of a pixel along x and y, or one size for both. [mm]

        Raises
        ------
        InputError
            If the map has lengths already, or a size is not positive.

        >>> pixels = HeightMap(z=np.zeros((2, 3)), x=np.arange(3.0), y=np.arange(2.0), calibrated=False)
        >>> pixels.scaled(0.1).x.tolist()
        [0.0, 0.1, 0.2]
        """
        if self.calibrated or self.x is None or self.y is None:
            raise InputError(f"the map {self.name!r} has lengths already: do not give a pixel size")
        along_x, along_y = pixel_size if isinstance(pixel_size, tuple) else (pixel_size, pixel_size)
        return replace(
            self,
            x=self.x * positive(along_x, "the pixel size along x", "mm"),
            y=self.y * positive(along_y, "the pixel size along y", "mm"),
            calibrated=True,
        )

    def thinned(self, most: int) -> HeightMap:
        """Return every n-th row and column, or scattered valid point, so that about ``most`` valid heights remain.

        A map with at most that many is returned unchanged.
        """
        most = whole_number(most, "most", 1)
        valid = np.isfinite(self.z)
        count = int(np.count_nonzero(valid))
        if count <= most:
            return self
        if self.scattered:
            chosen = np.flatnonzero(valid)[:: -(-count // most)]
            x, y = self.points()
            return replace(self, x=x[chosen], y=y[chosen], z=self.z[chosen])
        step = int(np.ceil(np.sqrt(count / most)))
        names = ("radius", "angle") if self.polar else ("x", "y")
        axes = {name: getattr(self, name)[::step] for name in names}
        return replace(self, z=self.z[::step, ::step], **axes)

    def moved(self, pose: Pose) -> HeightMap:
        """Return the valid heights as scattered points, moved as a rigid body. See `Pose`."""
        self.require_calibrated()
        x, y = self.points()
        valid = ~np.isnan(self.z)
        x, y, z = pose.apply(x[valid], y[valid], self.z[valid])
        return HeightMap(x=x, y=y, z=z, name=self.name, metadata=self.metadata)

    def turned_over(self) -> HeightMap:
        r"""Return the map turned half a turn about the y axis: :math:`z'(x, y) = -z(-x, y)`.

        It turns a map of the part frame, whose material is on the -z side, into the frame of a lens program, for a face
        whose material is on the +z side, and back. It is a rotation: no writing on the face is mirrored.

        >>> sloped = HeightMap(z=[[1.0, 2.0, 3.0]], x=[0.0, 1.0, 2.0], y=[0.0])
        >>> sloped.turned_over().x.tolist(), sloped.turned_over().z.tolist()
        ([-2.0, -1.0, 0.0], [[-3.0, -2.0, -1.0]])
        """
        if self.angle is not None:
            return replace(self, z=0.0 - self.z[::-1], angle=np.pi - self.angle[::-1])
        assert self.x is not None  # noqa: S101 - a map that is not polar has x
        if self.scattered:
            return replace(self, z=0.0 - self.z, x=0.0 - self.x)
        return replace(self, z=0.0 - self.z[:, ::-1], x=0.0 - self.x[::-1])

    def to_xarray(self) -> DataArray:
        """Return the map as an ``xarray.DataArray`` in mm, with x and y (or radius and angle) as coordinates.

        Scattered points have the dimension ``point``. ``units`` and the metadata are its attributes.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        try:
            from xarray import DataArray  # noqa: PLC0415 - an optional extra
        except ImportError as error:
            raise InputError("xarray is not installed: pip install 'turnwright[xarray]'") from error
        lateral = "mm" if self.calibrated else "pixel"
        rows, columns = ("angle", "radius") if self.polar else ("y", "x")
        units = {rows: "rad" if self.polar else lateral, columns: lateral}
        dims = ("point",) if self.scattered else (rows, columns)
        return DataArray(
            self.z,
            dims=dims,
            coords={
                name: (dims[0] if self.scattered else name, getattr(self, name), {"units": unit})
                for name, unit in units.items()
            },
            name=self.name or "z",
            attrs={**self.metadata, "units": "mm"},
        )

    def of_surface(self, surface: Surface) -> HeightMap:
        """Return the heights of a surface on the grid of this map, nan where this is.

        Raises
        ------
        InputError
            If this map has no lengths.
        DomainError
            If the surface is not defined at a point of the map.
        """
        self.require_calibrated()
        z = np.full(self.z.shape, np.nan)

        def fill(start: int, stop: int) -> None:
            rows = slice(start, stop)
            there, (x, y) = ~np.isnan(self.z[rows]), self.points(rows)
            if there.all():
                z[rows] = surface.sag(x, y)
            elif there.any():
                z[rows][there] = surface.sag(x[there], y[there])

        try:
            run_chunks(fill, self.z.shape[0], block_rows(self.z.shape))
        except DomainError:
            fill(0, self.z.shape[0])  # the message counts all points
            raise
        return replace(self, z=z)

    def minus(self, other: HeightMap | Surface) -> HeightMap:
        """Return this map minus another on the same grid, or minus a surface. Measured minus nominal is the error.

        A surface is not evaluated where the map has no height.

        Raises
        ------
        InputError
            If the other map has another grid, or this one has no lengths.
        DomainError
            If the surface is not defined at a point of the map.
        """
        if isinstance(other, HeightMap):
            for name in ("x", "y", "radius", "angle"):
                mine, theirs = getattr(self, name), getattr(other, name)
                if (mine is None) != (theirs is None) or (mine is not None and not np.array_equal(mine, theirs)):
                    raise InputError(f"the two height maps differ in {name}: resample them to one grid first")
            z = self.z - other.z
        else:
            z = self.z - self.of_surface(other).z
        return replace(self, z=z, name=f"{self.name} error".strip())
