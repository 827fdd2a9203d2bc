"""Files of instruments, packed byte by byte from the description of each format: no reader of ours helps.

Every maker takes the same picture: whole numbers, the first row at the top, nan where nothing was measured.
"""

import io
import struct
import zipfile
import zlib

import h5py
import numpy as np

PICTURE = np.array([[500.0, -30.0, 41.0, 7.0], [8.0, np.nan, -900.0, 11.0], [12.0, 13.0, 14.0, 1500.0]])
"""Rows from the top down, as a camera gives them. (3, 4)"""

WAVELENGTH, SCALE, OBLIQUITY, RESOLUTION = 632.8e-9, 0.5, 1.25, 2.5e-5
COUNTS = {0: 4096, 1: 32768, 2: 131072}


def single(value):
    """The number that single precision keeps."""
    return float(np.float32(value))  # noqa: TID251 - the format has 32 bits


def metropro(picture=PICTURE, *, kind=1, resolution=1, pixel=RESOLUTION, buckets=1, **fields):
    """MetroPro .dat: fields at their offsets, two bytes of camera picture and four of phase a pixel."""
    rows, columns = picture.shape
    head = bytearray(4096 if kind == 3 else 834)
    values = {
        "magic": (0, ">I", 0x881B036E + kind),
        "format": (4, ">H", kind),
        "size": (6, ">I", len(head)),
        "camera columns": (52, ">H", 5),
        "camera rows": (54, ">H", 2),
        "buckets": (56, ">H", buckets),
        "camera bytes": (60, ">I", 2 * 5 * 2 * buckets),
        "columns": (68, ">H", columns),
        "rows": (70, ">H", rows),
        "bytes": (72, ">I", 4 * rows * columns),
        "time": (76, ">i", 1429905292),
        "comment": (80, "82s", b"a dish\x00rubbish"),
        "scale": (164, ">f", SCALE),
        "wavelength": (168, ">f", WAVELENGTH),
        "obliquity": (176, ">f", OBLIQUITY),
        "pixel": (184, ">f", pixel),
        "phase resolution": (218, ">h", resolution),
        "sign": (232, ">h", 0),
        "objective": (246, "12s", b"Sm Aperture"),
    }
    for name, value in fields.items():
        values[name] = (*values[name][:2], value)
    for place, form, value in values.values():
        struct.pack_into(form, head, place, value)
    phase = np.where(np.isnan(picture), 2147483640, picture).astype(">i4")
    return bytes(head) + bytes(20 * buckets) + phase.tobytes()


def metropro_height(resolution=1):
    """Height of one count in mm, from numbers of single precision."""
    return single(SCALE) * single(WAVELENGTH) * single(OBLIQUITY) / COUNTS[resolution] * 1e3


def datx(picture=PICTURE, *, unit="Fringes", pixel=RESOLUTION, without=(), **create):
    """HDF5 as Mx writes it: one surface, with converters next to it."""
    converter = np.dtype(
        [
            ("Category", h5py.string_dtype()),
            ("BaseUnit", h5py.string_dtype()),
            ("Parameters", h5py.vlen_dtype(np.float64)),
        ]
    )
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        surface = file.create_dataset(
            "Data/Surface/{1CE20D93}", data=np.where(np.isnan(picture), 1.79769313e308, picture), **create
        )
        attributes = {
            "Unit": np.array([unit], dtype=h5py.string_dtype()),
            "No Data": np.array([1.79769313e308]),
            "Wavelength": np.array([WAVELENGTH]),
            "Interferometric Scale Factor": np.array([SCALE]),
            "Obliquity Factor": np.array([OBLIQUITY]),
            "X Converter": np.array([("LateralCat", "Pixels", np.array([0, pixel, 0, 0]))], dtype=converter),
            "Y Converter": np.array([("LateralCat", "Pixels", np.array([0, 2 * pixel, 0, 0]))], dtype=converter),
            "Z Converter": np.array(
                [("HeightCat", unit, np.array([0, WAVELENGTH, SCALE, OBLIQUITY]))], dtype=converter
            ),
        }
        for name, value in attributes.items():
            if name not in without:
                surface.attrs[name] = value
        about = file.create_group("Attributes/{846C}")
        about.attrs["Data Context.Data Attributes.Part Number"] = np.array(["7b"], dtype=h5py.string_dtype())
    return buffer.getvalue()


def zygo_head(magic, picture, pixel, resolution):
    rows, columns = picture.shape
    return [
        magic,
        '1 8 3 5 "Mon Jan 04 08:42:09 2010"',
        "0 0 0 0 0 0",
        f"10 20 {columns} {rows}",
        '"a dish"',
        '"part 7"',
        '""',
        f"0 {SCALE} {WAVELENGTH} 0 {OBLIQUITY} 0 {pixel} 1429905292",
        '640 480 4 0 0 0 "Sm Aperture "',
        "0 0 0 0 0 0 0 0 0 0",
        f"{resolution} 1 20 2 0 0 0 0 0",
        '0 "            "',
        "1 0",
        '"       "',
        "#",
    ]


def zygo_ascii(picture=PICTURE, *, pixel=RESOLUTION, resolution=1, empty_block=True):
    lines = zygo_head("Zygo ASCII Data File - Format 2", picture, pixel, resolution)
    lines += ["#"] if empty_block else []
    flat = [f"{2147483640 if np.isnan(p) else int(p)}" for p in picture.ravel()]
    lines += [" ".join(flat[start : start + 10]) for start in range(0, len(flat), 10)]
    return ("\n".join([*lines, "#"]) + "\n").encode()


def codev(picture=PICTURE, *, head="GRD 4 3 SUR WVL 0.6328 SSZ 20000 NDA -32768"):
    """CODE V interferogram: counts of WVL / SSZ um, on lines of any length."""
    flat = [f"{-32768 if np.isnan(p) else int(p):7d}" for p in picture.ravel()]
    lines = ["! of an interferometer", "a dish", head, *("".join(flat[start : start + 10]) for start in (0, 10))]
    return ("\n".join(lines) + "\n").encode()


def zygo_xyz(picture=PICTURE, *, pixel=RESOLUTION):
    """Heights in um."""
    lines = zygo_head("Zygo XYZ Data File - Format 1", picture, pixel, 1)
    for row, line in enumerate(picture):
        lines += [f"{10 + column} {20 + row} {'No Data' if np.isnan(z) else z}" for column, z in enumerate(line)]
    return ("\n".join([*lines, "#"]) + "\n").encode()


def digital_surf(picture=PICTURE, *, bits=32, packed=False, note=b"a dish", **fields):
    """Digital Surf .sur: 512 bytes of head, a note, whole numbers."""
    rows, columns = picture.shape
    lowest = int(np.nanmin(picture))
    raw = np.where(np.isnan(picture), lowest - 2, picture).astype(f"<i{bits // 8}").tobytes()
    values = {
        "magic": (0, "12s", b"DSCOMPRESSED" if packed else b"DIGITAL SURF"),
        "objects": (14, "<h", 1),
        "version": (16, "<h", 1),
        "kind": (18, "<h", 2),
        "not measured": (86, "<h", 1),
        "bits": (98, "<h", bits),
        "lowest": (100, "<i", lowest),
        "highest": (104, "<i", int(np.nanmax(picture))),
        "columns": (108, "<i", columns),
        "rows": (112, "<i", rows),
        "points": (116, "<i", rows * columns),
        "step x": (120, "<f", 0.5),
        "step y": (124, "<f", 0.25),
        "step z": (128, "<f", 0.125),
        "unit x": (180, "16s", b"\xe6m"),
        "unit y": (196, "16s", b"\xb5m"),
        "unit z": (212, "16s", b"nm"),
        "inverted": (290, "<h", 0),
        "time": (306, "<6h", (9, 42, 8, 4, 1, 2010)),
        "note": (334, "<h", len(note)),
    }
    head = bytearray(512)
    for name, value in fields.items():
        values[name] = (*values[name][:2], value)
    for place, form, value in values.values():
        struct.pack_into(form, head, place, *(value if isinstance(value, tuple) else (value,)))
    if packed:
        half = len(raw) // 2
        parts = [raw[:half], raw[half:]]
        streams = [zlib.compress(part) for part in parts]
        raw = struct.pack("<I", 2)
        raw += b"".join(struct.pack("<II", len(part), len(one)) for part, one in zip(parts, streams, strict=True))
        raw += b"".join(streams)
    return bytes(head) + note + raw


def sdf(picture=PICTURE, *, revision=2, kind=6, scales=(2e-6, 3e-6, 1e-9), shape=None):
    """ISO 25178-71, binary: rows ascend in y, so the picture goes in from its bottom."""
    rows, columns = shape or picture.shape
    counts = struct.pack("<HH" if revision == 1 else "<II", columns, rows)
    form, bad = {5: ("<i2", -(2**15)), 6: ("<i4", -(2**31)), 7: ("<f8", -np.finfo(np.float64).max)}[kind]
    head = f"bISO-{revision}.0".encode() + b"tests     " + b"010120261200" * 2 + counts
    head += struct.pack("<4d3B", *scales, -1.0, 0, kind, 0)
    return head + np.where(np.isnan(picture), bad, picture)[::-1].astype(form).tobytes()


def sdf_text(picture=PICTURE, revision=1):
    rows, columns = picture.shape
    head = [f"aISO-{revision}.0", "ManufacID = tests", "CreateDate = 010120261200", "ModDate = 010120261200"]
    head += [f"NumPoints = {columns}", f"NumProfiles = {rows}", "Xscale = 2.0E-6", "Yscale = 3.0E-6", "Zscale = 1.0E-9"]
    head += ["Zresolution = 1.0E-9", "Compression = 0", "DataType = 6", "CheckType = 0", "*"]
    body = [" ".join("BAD" if np.isnan(p) else str(int(p)) for p in row) for row in picture[::-1]]
    return "\r\n".join([*head, *body, "*", "OperatorName = Jane Doe", "*", ""]).encode()


X3P = """<?xml version="1.0" encoding="UTF-8"?>{before}
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{x}</Increment><Offset>1e-3</Offset></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{y}</Increment><Offset>-2e-3</Offset></CY>
<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
<Record2><Date>2010-01-04T08:42:09+00:00</Date><Instrument><Manufacturer>M</Manufacturer><Model>N</Model>
<Serial>1</Serial><Version>2</Version></Instrument><CalibrationDate>2010-01-04T08:42:09+00:00</CalibrationDate>
<ProbingSystem><Type>NonContacting</Type><Identification>lens</Identification></ProbingSystem>
<Comment>{comment}</Comment></Record2>
<Record3><MatrixDimension><SizeX>{columns}</SizeX><SizeY>{rows}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3>
<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>"""


def x3p(picture=PICTURE, *, data=None, **fields):
    """ISO 25178-72: heights in m, rows ascending in y, so the picture goes in from its bottom."""
    rows, columns = picture.shape
    values = {"before": "", "x": 2e-6, "y": 3e-6, "comment": "a dish", "rows": rows, "columns": columns, **fields}
    raw = (picture[::-1] * 1e-9).astype("<f8").tobytes() if data is None else data
    return archive({"main.xml": X3P.format(**values).encode(), "bindata/data.bin": raw})


def archive(members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return buffer.getvalue()


def grid_sag(picture=PICTURE, *, unit=0, flagged=True):
    rows, columns = picture.shape
    lines = ["! a dish", f"{columns} {rows} 0.5 0.25 {unit} 1 -2"]
    for z in picture.ravel():
        flag = " 1" if np.isnan(z) else " 0"
        lines.append(f"{0 if np.isnan(z) else z} 0 0 0{flag if flagged else ''}")
    return ("\r\n".join(lines) + "\r\n").encode()


def al3d(picture=PICTURE):
    """Alicona .al3d: tags of fixed length, then single precision in m, rows from the top, padded to eight bytes."""
    rows, columns = picture.shape
    tags = {
        "Cols": columns,
        "Rows": rows,
        "PixelSizeXMeter": 2e-6,
        "PixelSizeYMeter": 3e-6,
        "DepthImageOffset": 17 + 52 * 9 + 256,
        "InvalidPixelValue": -1,
        "IconOffset": 0,
    }
    pairs = {"Version": 1, "TagCount": len(tags), **tags}
    head = b"AliconaImaging\0\r\n"
    for key, value in pairs.items():
        head += key.encode().ljust(20, b"\0") + str(value).encode().ljust(30, b"\0") + b"\r\n"
    return head + bytes(256) + np.where(np.isnan(picture), -1, picture * 1e-9).astype("<f4").tobytes()


def plu(picture=PICTURE, *, layers=1, **fields):
    """Sensofar .plu: 500 bytes of head, then the size of a layer, its heights in um, and their range."""
    rows, columns = picture.shape
    head = bytearray(508)
    values = {
        "date": (0, "128s", b"Mon Jan 04 08:42:09 2010"),
        "comment": (132, "256s", b"a dish"),
        "size": (388, "<2I", rows, columns),
        "pixel": (404, "<2f", 2.0, 3.0),
        "type": (428, "<I", 3),
        "layers": (489, "<B", layers),
        "layer size": (500, "<2I", rows, columns),
    }
    for name, value in fields.items():
        values[name] = (*values[name][:2], value)
    for place, form, *value in values.values():
        struct.pack_into(form, head, place, *value)
    heights = np.where(np.isnan(picture), 1000001, picture).astype("<f4")
    return bytes(head) + heights.tobytes() + struct.pack("<2f", np.nanmin(picture), np.nanmax(picture))


def array_file(array, **named):
    """NumPy .npy, or .npz of named arrays."""
    buffer = io.BytesIO()
    if named:
        np.savez(buffer, **named)
    else:
        np.save(buffer, array)
    return buffer.getvalue()
