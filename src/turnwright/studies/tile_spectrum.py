"""Power spectral density of a map in tiles: the mean over its segments."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from turnwright import _validate as validate
from turnwright._arrays import Floats, frozen
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import FEWEST, AreaSpectrum, Spectrum
from turnwright.studies.bands import map_in_order

if TYPE_CHECKING:
    from turnwright.progress import Progress
    from turnwright.studies.tile_files import Files
    from turnwright.studies.tile_layout import Layout

__all__ = ["SEGMENT", "mean_spectrum"]

SEGMENT = 512
"""Pixels along a segment: about 0.5 mm at a pixel of 1 um, fifty cusps or more."""

AnySpectrum = TypeVar("AnySpectrum", AreaSpectrum, Spectrum)


def mean_spectrum(
    files: Files, asked: int | None, work: Callable[[HeightMap], AnySpectrum], progress: Progress | None
) -> AnySpectrum:
    """Return the mean of the spectra of all complete segments."""
    layout = files.layout
    segment = _segment(layout, asked)
    rows, columns = (size // segment for size in layout.shape)
    # Pieces of about a tile, so that a file is read a few times at most.
    many = max(1, layout.tile[1] // segment)
    down = max(1, layout.tile[0] // segment)
    pieces = [(j, i) for j in range(0, rows, down) for i in range(0, columns, many)]
    step_x, step_y = (np.asarray(np.arange(segment) * step, dtype=np.float64) for step in layout.pixel)

    def spectra(piece: tuple[int, int]) -> tuple[Floats | None, int, AnySpectrum | None]:
        """Return the sum of the densities of a piece, how many there are, and one as a pattern."""
        j, i = piece
        last_j, last_i = min(j + down, rows), min(i + many, columns)
        z = np.asarray(files.levels[0][j * segment : last_j * segment, i * segment : last_i * segment])
        total, count, pattern = None, 0, None
        for row in range(0, z.shape[0], segment):
            for column in range(0, z.shape[1], segment):
                part = z[row : row + segment, column : column + segment]
                if np.isnan(part).any():
                    continue
                pattern = work(HeightMap(x=step_x, y=step_y, z=part))
                total = pattern.density.copy() if total is None else total + pattern.density
                count += 1
        return total, count, pattern

    merged, number, like = None, 0, None
    for done, (total, count, pattern) in enumerate(map_in_order(spectra, pieces), 1):
        if total is not None:
            merged = total if merged is None else merged + total
            number, like = number + count, pattern
        if progress is not None:
            progress(done, len(pieces))
    if merged is None or like is None:
        raise InputError(f"no segment of {segment} x {segment} pixels is free of gaps: use a smaller one")
    note = (
        f"the mean of {number} segments of {segment} x {segment} pixels side by side, {rows * columns - number} with "
    )
    density = frozen(merged / number, "density", ndim=merged.ndim)
    spectrum = replace(like, density=density, notes=(f"{note}missing heights left out",))
    return replace(spectrum, count=spectrum.count * number) if isinstance(spectrum, Spectrum) else spectrum


def _segment(layout: Layout, segment: int | None) -> int:
    if segment is None:
        return max(FEWEST, min(SEGMENT, 1 << int(math.log2(min(layout.shape) / 4))))
    return validate.whole_number(segment, "the width of a segment in pixels", FEWEST, min(layout.shape))
