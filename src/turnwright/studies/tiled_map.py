"""A whole part on disk: windows of it at any zoom, its roughness and its spectra."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Self

import numpy as np

from turnwright import _validate as validate
from turnwright._arrays import Floats
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import AreaSpectrum, Roughness, Spectrum, Window, area_psd, line_psd
from turnwright.progress import Progress
from turnwright.studies.tile_files import PART_PIXELS, Files, resolve_place
from turnwright.studies.tile_roughness import tiled_roughness
from turnwright.studies.tile_spectrum import mean_spectrum

__all__ = ["TiledMap"]


@dataclass(frozen=True, slots=True, eq=False)
class TiledMap:
    """A map that is too large for memory, in a store; see `generate_tiled`. Only requested parts are read.

    Parameters
    ----------
    files
        Files of the map.
    """

    files: Files

    @classmethod
    def open(cls, store: str | os.PathLike[str]) -> Self:
        """Open a map that is complete.

        Parameters
        ----------
        store
            A folder, or a URL that fsspec supports.

        Raises
        ------
        InputError
            If the store holds no map, or some of its tiles are missing.
        """
        place = resolve_place(store)
        try:
            files = Files.open(place)
        except OSError as error:
            raise InputError(
                f"the map {place!r} cannot be read ({error.strerror or error}): check its name and permissions"
            ) from None
        if not files.about["complete"]:
            there, total = int(files.finished().sum()), sum(1 for _ in files.layout.tiles())
            raise InputError(f"the map {files.place!r} has {there} of {total} tiles: repeat the call that began it")
        return cls(files)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.files.layout.shape

    @property
    def pixel(self) -> tuple[float, float]:
        """Pixel size along x and y. [mm]."""
        return self.files.layout.pixel

    @property
    def tile(self) -> tuple[int, int]:
        """Rows and columns of a tile."""
        return self.files.layout.tile

    @property
    def levels(self) -> int:
        """Number of levels: level 0 is the map, each further level has half the pixels along each axis."""
        return self.files.layout.levels

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Centres of the first and last column, and of the first and last row. [mm]."""
        x, y = self.files.layout.axes()
        return float(x[0]), float(x[-1]), float(y[0]), float(y[-1])

    @property
    def valid(self) -> int:
        """Number of heights."""
        return int(np.nansum(self.files.read_records()[:, :, 0]))

    @property
    def unreached(self) -> int:
        """Number of pixels of the part that no pass covers."""
        records = self.files.read_records()
        return int(np.nansum(records[:, :, PART_PIXELS] - records[:, :, 0]))

    def height_map(self, level: int = 0) -> HeightMap:
        """Return the whole map, or a whole overview, in memory.

        Parameters
        ----------
        level
            0 for the map itself.

        Raises
        ------
        InputError
            If there is no such level.
        """
        level = validate.whole_number(level, "the level", 0, self.levels - 1)
        rows, columns = self.files.layout.level_shape(level)
        return self._read(level, slice(0, rows), slice(0, columns))

    def window(self, *, x: tuple[float, float], y: tuple[float, float], pixels: int = 1000) -> HeightMap:
        """Return a part of the map, from the coarsest overview that shows it with as many pixels.

        Parameters
        ----------
        x, y
            Limits of the window; it is clipped to the map. [mm]
        pixels
            Least number of pixels along the longer side, if the map has them.

        Raises
        ------
        InputError
            If the limits do not ascend, or the window has no pixel of the map.
        """
        x, y = validate.span(x, "the window along x"), validate.span(y, "the window along y")
        pixels = validate.whole_number(pixels, "the width of a window in pixels", 1)
        selection: tuple[slice, slice] | None = None
        for level in reversed(range(self.levels)):
            spans = [_within(axis, span) for axis, span in zip(self.files.layout.axes(level), (x, y), strict=True)]
            sizes = [span.stop - span.start for span in spans]
            selection = spans[1], spans[0]
            if min(sizes) > 0 and max(sizes) >= pixels:
                break
        assert selection is not None  # noqa: S101 - there is at least one level
        if min(span.stop - span.start for span in selection) < 1:
            low_x, high_x, low_y, high_y = self.extent
            raise InputError(
                f"the window x {x[0]:g} to {x[1]:g}, y {y[0]:g} to {y[1]:g} mm holds no pixel of the map, which is x "
                f"{low_x:g} to {high_x:g}, y {low_y:g} to {high_y:g} mm: move or widen it"
            )
        return self._read(level, *selection)

    def roughness(
        self, *, form: Literal["none", "mean", "plane"] = "plane", progress: Progress | None = None
    ) -> Roughness:
        """Return the surface parameters of the whole map: those of `roughness`, to 1e-12 of each.

        The map is read once, a few tiles at a time. The plane follows from sums stored with each tile, and each tile is
        extended by the first row and column of its neighbours, so that no difference is missed. ``sal`` and ``str`` are
        nan: they need the transform of the whole map; take them from a `window`.

        Parameters
        ----------
        form
            Form that is removed first.
        progress
            Called with (tiles done, all tiles).

        Raises
        ------
        InputError
            If the form is another one, or the map has no heights.

        Sources
        -------
        [Chan1983]_ merges sums about different means. Oracle: `roughness` in one piece.
        """
        validate.listener(progress)
        return tiled_roughness(self.files, form, progress)

    def area_psd(
        self,
        *,
        segment: int | None = None,
        form: Literal["none", "mean", "plane"] = "plane",
        window: Window = "hann",
        progress: Progress | None = None,
    ) -> AreaSpectrum:
        """Return the power spectral density of the map: the mean of `area_psd` over its segments (Welch).

        The segments start at the first row and column and do not overlap. Segments with a missing height, and
        incomplete ones at the end, are left out; ``notes`` states their number. Wavelengths longer than a segment are
        not resolved.

        Parameters
        ----------
        segment
            Pixels along each side of a segment; by default 512, or less for at least four segments along each side.
        form, window
            Of each segment; see `area_psd`.
        progress
            Called with (bands done, all bands).

        Raises
        ------
        InputError
            If no segment is whole, or a choice is unknown.

        Sources
        -------
        [Welch1967]_. Oracle: SciPy's periodogram of each segment, averaged.
        """
        validate.listener(progress)
        work = partial(area_psd, form=form, window=window)
        return mean_spectrum(self.files, segment, work, progress)

    def line_psd(
        self,
        *,
        along: Literal["x", "y"],
        segment: int | None = None,
        form: Literal["none", "mean", "plane"] = "plane",
        window: Window = "hann",
        progress: Progress | None = None,
    ) -> Spectrum:
        """Return the power spectral density of the lines of the map: the mean of `line_psd` over its segments (Welch).

        Parameters
        ----------
        along
            Which way the lines run.
        segment, form, window, progress
            See `area_psd` of the map.

        Raises
        ------
        InputError
            If no segment is whole, or a choice is unknown.
        """
        validate.listener(progress)
        if not isinstance(along, str) or along not in ("x", "y"):
            raise InputError(f'along is {along!r}, the lines of a map in tiles run along "x" or "y": choose')
        work = partial(line_psd, along=along, form=form, window=window)
        return mean_spectrum(self.files, segment, work, progress)

    def _read(self, level: int, rows: slice, columns: slice) -> HeightMap:
        x, y = self.files.layout.axes(level)
        z: Any = self.files.levels[level][rows, columns]
        name = "generated error" if self.files.about["error"] else "generated"
        return HeightMap(x=x[columns], y=y[rows], z=np.asarray(z, dtype=np.float64), name=name)


def _within(axis: Floats, span: tuple[float, float]) -> slice:
    tiny = 1e-9 * (axis[1] - axis[0]) if axis.size > 1 else 0.0
    start, stop = np.searchsorted(axis, span[0] - tiny), np.searchsorted(axis, span[1] + tiny, side="right")
    return slice(int(start), int(max(start, stop)))
