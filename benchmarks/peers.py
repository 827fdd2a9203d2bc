"""The same work by Turnwright and by other open programs, side by side in one run.

    python benchmarks/peers.py

Peers are surfalize, SurfaceTopography and prysm (installed with ``.[test]``) and OpenCAMLib (``pip install
opencamlib``). A row whose peer is not installed is left out. The run takes a minute and writes ``PEERS.md`` beside this
file.
"""

import struct
import tempfile
import warnings
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np
from run import LENS, seconds, spiral, timed

from turnwright.files import read_map, write_map
from turnwright.heightmap import HeightMap
from turnwright.metrology import filter_map, fit_zernike, line_psd, roughness
from turnwright.optics import wavefront
from turnwright.part import Part
from turnwright.placing import place
from turnwright.tool import Tool

HERE = Path(__file__).parent
DATX = HERE.parent / "tests" / "data" / "measured" / "gpi_mirror_strip.datx"
SIDE, PIXEL = 1024, 0.001

Row = tuple[str, str, str, list[float], list[float]]


def rough_map():
    """Heights of a turned flat: cusps, a long wave and noise. [mm]."""
    x = PIXEL * np.arange(SIDE)
    noise = np.random.default_rng(1).normal(size=(SIDE, SIDE))
    z = 2e-5 * np.cos(2 * np.pi * x / 0.01) + 1e-4 * np.cos(2 * np.pi * x[:, None] / 0.4) + 2e-6 * noise
    return HeightMap(z=z, x=x, y=x)


def plu(heights):
    """The bytes of a Sensofar .plu with one layer; no program writes it. The fields that no reader uses are 0."""
    rows, columns = heights.z.shape
    head = bytearray(508)
    for offset, form, *values in (
        (0, "128s", b"2026-01-01 12:00:00"),
        (388, "<2I", rows, columns),
        (404, "<2f", PIXEL * 1e3, PIXEL * 1e3),
        (428, "<I", 3),  # a topography
        (489, "<B", 1),  # layer
        (500, "<2I", rows, columns),
    ):
        struct.pack_into(form, head, offset, *values)
    return bytes(head) + (heights.z * 1e3).astype("<f4").tobytes() + bytes(8)


def readers():
    from prysm.io import read_zygo_datx  # noqa: PLC0415 - may not be installed
    from SurfaceTopography.IO import open_topography  # noqa: PLC0415 - may not be installed
    from surfalize import Surface  # noqa: PLC0415 - may not be installed

    def topography(file):
        with open_topography(str(file)) as reader:
            return reader.topography().heights()

    heights = rough_map()
    with tempfile.TemporaryDirectory() as folder:
        files = {suffix: Path(folder) / f"map{suffix}" for suffix in (".x3p", ".sur", ".sdf", ".plu")}
        write_map(heights, files[".x3p"])
        files[".plu"].write_bytes(plu(heights))
        for suffix in (".sur", ".sdf"):
            Surface(heights.z * 1e3, PIXEL * 1e3, PIXEL * 1e3).save(files[suffix])
        for suffix, peer, reader, note in (
            (".x3p", "surfalize", Surface.load, "theirs without the checksum of the heights"),
            (".x3p", "SurfaceTopography", topography, ""),
            (".sur", "surfalize", Surface.load, ""),
            (".sdf", "surfalize", Surface.load, ""),
            (".plu", "surfalize", Surface.load, "theirs in single precision, from two points before the first"),
            (".plu", "SurfaceTopography", topography, ""),
        ):
            file = files[suffix]
            ours, theirs = timed(lambda f=file: read_map(f), lambda f=file, read=reader: read(f))
            yield f"read {suffix} of {SIDE} x {SIDE}", peer, note, ours, theirs
    ours, theirs = timed(lambda: read_map(DATX), lambda: read_zygo_datx(DATX))
    yield f"read .datx of {DATX.stat().st_size / 1024:.0f} kB", "prysm", "ours in another process", ours, theirs


def surfaces():
    from SurfaceTopography import Topography  # noqa: PLC0415 - may not be installed
    from surfalize import Surface  # noqa: PLC0415 - may not be installed

    heights = rough_map()
    theirs_um = Surface(heights.z * 1e3, PIXEL * 1e3, PIXEL * 1e3)
    ours, theirs = timed(
        lambda: filter_map(heights, 0.08, kind="gaussian"), lambda: theirs_um.filter("lowpass", 80.0), times=3
    )
    yield f"Gaussian filter of {SIDE} x {SIDE}", "surfalize", "", ours, theirs

    def parameters():
        fresh = Surface(heights.z * 1e3, PIXEL * 1e3, PIXEL * 1e3)  # it caches its parameters
        return fresh.level().roughness_parameters(
            ["Sa", "Sq", "Sz", "Ssk", "Sku", "Sdq", "Sdr", "Sal", "Str", "Sk", "Spk", "Svk"]
        )

    def ours_of():
        found = roughness(heights)
        return [getattr(found, name) for name in ("sa_nm", "sq_nm", "sz_nm", "ssk", "sku", "sdq", "sdr", "sal", "str")]

    ours, theirs = timed(ours_of, parameters, times=3)
    yield f"areal parameters of {SIDE} x {SIDE}", "surfalize", "", ours, theirs
    topography = Topography(heights.z.T, (SIDE * PIXEL, SIDE * PIXEL), unit="mm")
    ours, theirs = timed(
        lambda: line_psd(heights, along="x"), lambda: topography.power_spectrum_from_profile(window="hann"), times=9
    )
    yield f"line PSD of {SIDE} x {SIDE}", "SurfaceTopography", "", ours, theirs


def light():
    from prysm.coordinates import cart_to_polar, make_xy_grid  # noqa: PLC0415 - may not be installed
    from prysm.polynomials import fringe_to_nm, lstsq, zernike_nm  # noqa: PLC0415 - may not be installed
    from prysm.propagation import Wavefront  # noqa: PLC0415 - may not be installed

    n = 512
    x, y = make_xy_grid(n, diameter=2)
    rho, phi = cart_to_polar(x, y)
    inside = rho <= 1

    def basis():
        return np.array([zernike_nm(*fringe_to_nm(j), rho, phi) for j in range(1, 38)])

    z = np.tensordot(np.random.default_rng(2).normal(size=37) * 1e-5, basis(), 1)
    z[~inside] = np.nan
    heights = HeightMap(z=z, x=x[0], y=y[:, 0])

    ours, theirs = timed(
        lambda: fit_zernike(heights, terms=37, indexing="fringe", radius=1.0), lambda: lstsq(basis(), z), times=3
    )
    yield f"fit of 37 Zernike terms to {n} x {n}", "prysm", "", ours, theirs

    def psf():
        pupil = Wavefront.from_amp_and_phase(inside.astype(float), np.nan_to_num(z) * 2e6, 0.6328, x[0, 1] - x[0, 0])
        return pupil.focus(100.0, Q=2).intensity

    ours, theirs = timed(lambda: wavefront(heights, wavelength=632.8e-6, radius=1.0).psf(), psf, times=3)
    yield f"point spread of a pupil of {n} x {n}", "prysm", "theirs on a pupil of pixels", ours, theirs


def drop_cutter():
    """A ball on triangles: the same question on a coarser description of the surface."""
    import opencamlib as ocl  # noqa: PLC0415 - may not be installed

    points, step = 1_000, 0.2
    x = np.arange(-8.0, 8.0 + step, step)
    z = LENS.sag(*(one.ravel() for one in np.meshgrid(x, x))).reshape(x.size, x.size)
    surface = ocl.STLSurf()
    for j in range(x.size - 1):
        for i in range(x.size - 1):
            a, b, c, d = (ocl.Point(x[i + q], x[j + p], z[j + p, i + q]) for p in (0, 1) for q in (0, 1))
            surface.addTriangle(ocl.Triangle(a, b, d))
            surface.addTriangle(ocl.Triangle(a, d, c))
    plan, tool = spiral(points, 100, 7.25), Tool(nose_radius=1.5, included=np.deg2rad(120))
    part = Part(surface=LENS, radius=7.25)
    at = list(zip(plan.radius * np.cos(plan.angle), plan.radius * np.sin(plan.angle), strict=True))

    ball = ocl.BallCutter(3.0, 10.0)  # as the surface it must outlive the work: OpenCAMLib keeps no reference

    def drop():
        cutter = ocl.BatchDropCutter()
        cutter.setSTL(surface)
        cutter.setCutter(ball)
        for one in at:
            cutter.appendPoint(ocl.CLPoint(*one, -10.0))
        cutter.run()
        return cutter.getCLPoints()

    ours, theirs = timed(lambda: place(plan, part, tool), drop, times=2)
    yield f"place {points:.0e} points", "OpenCAMLib", "theirs a ball on triangles of 200 um", ours, theirs


GROUPS = {readers: "surfalize", surfaces: "SurfaceTopography", light: "prysm", drop_cutter: "opencamlib"}


def main():
    lines = ["| what | time | peer | its time | ratio | |", "| --- | --- | --- | --- | --- | --- |"]
    for group, package in GROUPS.items():
        if find_spec(package) is None:
            print(f"{package} is not installed")
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for what, peer, note, ours, theirs in group():
                ratio = median(a / b for a, b in zip(ours, theirs, strict=True))
                cells = (what, seconds(median(ours)), peer, seconds(median(theirs)), f"{ratio:.2g}", note)
                lines.append("| " + " | ".join(cells) + " |")
                print(lines[-1], flush=True)
    used = ", ".join(f"{name} {version(name)}" for name in GROUPS.values() if find_spec(name))
    (HERE / "PEERS.md").write_text("\n".join(lines) + f"\n\nA ratio below 1 means that Turnwright is faster. {used}.\n")


if __name__ == "__main__":
    main()
