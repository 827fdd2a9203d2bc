"""Result files of a run next to its program: JSON numbers, NumPy maps and one HDF5 archive.

``result.json`` (numbers in mm, rad, s and N unless the name ends in a unit; ``null`` for infinite or undefined values)
has the keys

``schema``, ``turnwright``, ``ok``
    1; the version; whether the tool has access to the part and all machine limits are met.
``verdicts``, ``keeps_tolerances``
    One entry per limit and place: ``tolerance`` (its key, or the call-out of the drawing), ``quantity``, ``place``,
    ``unit`` of the numbers, ``limit``, ``value``, ``uncertainty`` (expanded, k = 2), ``kept`` (``null`` if it was not
    evaluated or is not decided), ``reason``, ``sentence``; whether none is missed.
``part``, ``machine``, ``dialect``
    Names.
``access``
    The fields of `turnwright.access.Access`, ``findings`` with their sentences.
``passes``
    One entry per pass: the fields of `turnwright.job.Pass`, ``limits`` with the fields of `turnwright.motion.Limits`.
``least_clearance``
    Minimum height of the cutting edge above the surface over the finishing path.
``program``
    File names (main program first), number of lines and bytes, minutes of the cuts and of the links between them, entry
    of the tool in each pass, and the hash of all points.
``predictions``
    One entry per map: ``name``, ``file`` of the heights (cut minus design, mm), ``axes`` (files by name), ``shape`` and
    ``roughness`` with the fields of `turnwright.metrology.Roughness`. ``pv_nm`` is compared with the tolerance: of the
    whole part, from its highest to its lowest point, given in ``form`` with ``x``, ``y`` and ``error`` in mm (``null``
    for a patch, whose ``pv_nm`` is that of ``roughness``). ``tracking`` is ``null`` unless the servos were simulated;
    then it has the ``file`` of their contribution to the heights (mm), and its ``pv_nm`` and ``rms_nm``.
``optics``
    ``null`` unless the job states its light; then the numbers of `turnwright.job.OpticalPerformance`.
``rounding_nm``, ``rounding_limit_nm``
    Largest difference between the surfaces of the program on disk and of the planned motion, and its limit.
``warnings``, ``timings``, ``peak_memory_gb``
    Sentences; wall time of each stage; largest resident memory.
"""

from __future__ import annotations

import io
import re
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright import __version__
from turnwright._io import atomic_file, json_data, write_atomic, write_json
from turnwright.errors import InputError
from turnwright.files import write_map
from turnwright.heightmap import HeightMap
from turnwright.post import entry_words
from turnwright.report.optics import optics_numbers

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from os import PathLike

    from turnwright._arrays import Floats
    from turnwright.diagnosis import Diagnosis
    from turnwright.job import Comparison, Correction, Measured, OpticalPerformance, Prediction, Result, Verdict
    from turnwright.metrology import Roughness, Spectrum
    from turnwright.studies import TiledMap

__all__ = [
    "archive_comparison",
    "archive_correction",
    "archive_diagnosis",
    "archive_measured",
    "archive_optics",
    "archive_run",
    "archive_tiled",
    "read_maps",
    "write_maps",
]

AXES = ("x", "y", "radius", "angle")

VERDICT_FIELDS = (
    "tolerance", "quantity", "place", "unit", "limit", "value", "uncertainty", "reason", "sentence",
)  # fmt: skip

ARRAY_UNITS = {
    **dict.fromkeys(("angle", "sweep", "C", "sweep_low", "sweep_high", "rake"), "rad"),
    **dict.fromkeys(("axial", "radial", "cutting"), "N"),
    **dict.fromkeys(("points", "inside"), "1"),
    "time": "s",
    "area": "mm^2",
}
"""Units of arrays in the archive; all others are in mm."""


def archive_run(result: Result, folder: str | PathLike[str]) -> None:
    """Write ``job.toml``, ``result.json``, ``maps/*.npy`` and ``run.h5`` to the folder of the program."""
    folder = Path(folder)
    job = result.job.to_toml()
    write_atomic(folder / "job.toml", job)
    numbers = {
        "ok": result.ok,
        "verdicts": _verdicts(result.verdicts),
        "part": result.part.name,
        "machine": result.machine.name,
        "dialect": result.machine.dialect,
        **_fields(result, "keeps_tolerances", "access", "passes", "least_clearance"),
        "program": {
            "files": [file.name for file in result.program.files],
            "entries": {name: entry_words(one) for name, one in result.program.approaches.items()},
            **_fields(result.program, "lines", "bytes", "minutes", "links_minutes", "hash"),
        },
        "predictions": write_maps(result.predictions, folder),
        "optics": None if result.optics is None else optics_numbers(result.optics),
        **_fields(result, "rounding_nm", "rounding_limit_nm", "warnings", "timings", "peak_memory_gb"),
    }
    _write_json(folder / "result.json", numbers)
    _write_h5(result, job, (folder / "result.json").read_text(encoding="utf-8"), folder / "run.h5")


def archive_comparison(comparison: Comparison, folder: str | PathLike[str]) -> None:
    """Write ``job.toml`` and ``comparison.json`` with all numbers of every strategy."""
    folder = Path(folder)
    write_atomic(folder / "job.toml", comparison.job.to_toml())
    numbers = {
        "scallop": comparison.scallop,
        "chord": comparison.chord,
        "candidates": [
            {
                **_fields(one, "name", "refused", "turns", "size_bytes", "limits", "wall_s"),
                "strategy": comparison.stated(one),
                "breakdown": None
                if one.breakdown is None
                else _fields(one.breakdown, *_field_names(one.breakdown, but="error")),
            }
            for one in comparison.candidates
        ],
    }
    _write_json(folder / "comparison.json", numbers)


def archive_tiled(tiled: TiledMap, rough: Roughness, spectrum: Spectrum, folder: str | PathLike[str]) -> None:
    """Write ``tiled.json`` and ``spectrum.csv``."""
    folder = Path(folder)
    numbers = {
        "map": {"shape": list(tiled.shape), "pixel_mm": list(tiled.pixel), "extent_mm": list(tiled.extent)},
        "roughness": rough,
    }
    _write_json(folder / "tiled.json", numbers)
    unit = spectrum.unit.replace("²", "2").replace(" ", "_")
    lines = (f"{f:.17g},{density:.17g}" for f, density in zip(spectrum.frequency, spectrum.density, strict=True))
    table = [f"frequency_per_mm,density_{unit}", *lines]
    write_atomic(folder / "spectrum.csv", "\n".join(table) + "\n")


def archive_optics(performance: OpticalPerformance, folder: str | PathLike[str]) -> None:
    """Write ``result.json`` with the optical performance, and the wavefront as a map in mm."""
    folder = Path(folder)
    write_map(performance.wavefront.opd, folder / "wavefront.npz")
    _write_json(folder / "result.json", {"optics": optics_numbers(performance), "wavefront": "wavefront.npz"})


def archive_measured(measured: Measured, folder: str | PathLike[str]) -> None:
    """Write ``measured.json``, ``error.npz`` (error over the part) and, for a lens array, ``lenslets.csv``."""
    folder = Path(folder)
    write_map(measured.error, folder / "error.npz")
    if measured.lenslets is not None:
        write_atomic(folder / "lenslets.csv", measured.lenslets.csv())
    numbers = {"part": measured.job.part.name, "verdicts": _verdicts(measured.verdicts), **_measured_numbers(measured)}
    _write_json(folder / "measured.json", numbers)


def _verdicts(verdicts: Iterable[Verdict]) -> list[dict[str, Any]]:
    return [{"kept": one.is_kept, **_fields(one, *VERDICT_FIELDS)} for one in verdicts]


def _measured_numbers(measured: Measured) -> dict[str, object]:
    """Return the numbers of a measured part."""
    registration, terms = measured.registration, measured.zernike
    return {
        "name": measured.heights.name,
        "form_pv_nm": measured.form_pv_nm,
        "form_rms_nm": measured.form_rms_nm,
        "outliers": measured.outliers,
        "registration": {
            **_fields(
                registration,
                "pose",
                "pivot",
                "std",
                "held",
                "count",
                "lost",
                "rms_nm",
                "noise_nm",
                "correlated_nm",
                "correlation_length",
                "candidates",
            ),
            "sentences": (registration.sentences[0], *measured.open_questions),
        },
        "zernike": terms and _fields(terms, "indexing", "radius", "indices", "coefficients", "uncertainty"),
        "roughness": measured.roughness,
        "instrument_effect_nm": measured.instrument_effect_nm,
        "texture": measured.texture,
        "base_form": _base_form(measured),
    }


def _base_form(measured: Measured) -> dict[str, object] | None:
    """Return the edge height of each Zernike term (ANSI) of the base of a lens array. [mm]."""
    lenslets = measured.lenslets
    if lenslets is None or lenslets.base_form is None:
        return None
    return {
        str(number): {"height": value, "std": lenslets.base_form_std[number]}
        for number, value in dict(lenslets.base_form.terms).items()
    }


def archive_diagnosis(measured: Sequence[Measured], diagnosis: Diagnosis, folder: str | PathLike[str]) -> None:
    """Write ``diagnosis.json`` and the residual of each map as ``left-1.npz``, ``left-2.npz`` ..."""
    folder = Path(folder)
    for number, residual in enumerate(diagnosis.residuals, 1):
        write_map(residual, folder / f"left-{number}.npz")
    _write_json(folder / "diagnosis.json", _diagnosis_numbers(measured, diagnosis))


def _diagnosis_numbers(measured: Sequence[Measured], diagnosis: Diagnosis) -> dict[str, object]:
    """Return the numbers of a diagnosis."""
    return {
        "measured": [_measured_numbers(part) for part in measured],
        "findings": list(diagnosis),
        **_fields(
            diagnosis,
            "contributions",
            "names",
            "correlation",
            "measured_rms_nm",
            "explained_rms_nm",
            "unexplained_rms_nm",
            "noise_nm",
            "repeatability_nm",
        ),
    }


def archive_correction(
    measured: Sequence[Measured], diagnosis: Diagnosis, correction: Correction, folder: str | PathLike[str]
) -> None:
    """Write ``correction.json`` and ``predicted.npz`` to the folder of the corrected job."""
    folder = Path(folder)
    write_map(correction.simulated if correction.predicted is None else correction.predicted, folder / "predicted.npz")
    numbers = {name: {"pv_nm": pv, "rms_nm": rms} for name, (pv, rms) in correction.numbers_nm.items()}
    summary = _fields(correction, "cutoff", "sources", "proof", "sentences")
    _write_json(folder / "correction.json", {**summary, **numbers, **_diagnosis_numbers(measured, diagnosis)})


def _fields(value: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def _field_names(value: Any, *, but: str) -> list[str]:
    return [one.name for one in fields(value) if one.name != but]


def _write_json(file: Path, numbers: Mapping[str, object]) -> None:
    """Write numbers with the schema and the version."""
    write_json(file, {"schema": 1, "turnwright": __version__, **numbers})


def write_maps(predictions: Iterable[Prediction], folder: str | PathLike[str]) -> list[dict[str, Any]]:
    """Write heights and axes of maps as ``maps/NAME.npy`` ...; return their entries in ``result.json``."""
    entries = []
    (Path(folder) / "maps").mkdir()
    for prediction in predictions:
        stem = f"maps/{re.sub('[^A-Za-z0-9_-]+', '-', prediction.name)}"
        axes = {name: f"{stem}.{name}.npy" for name in AXES if getattr(prediction.error, name) is not None}
        _save(Path(folder) / f"{stem}.npy", prediction.error.z)
        for name, file in axes.items():
            _save(Path(folder) / file, getattr(prediction.error, name))
        tracking = None
        if prediction.tracking is not None and prediction.tracking_nm is not None:
            pv, rms = prediction.tracking_nm
            tracking = {"file": f"{stem}.tracking.npy", "pv_nm": pv, "rms_nm": rms}
            _save(Path(folder) / f"{stem}.tracking.npy", prediction.tracking.z)
        entries.append(
            {
                "name": prediction.name,
                "file": f"{stem}.npy",
                "axes": axes,
                "shape": prediction.error.z.shape,
                "roughness": json_data(prediction.roughness),
                "pv_nm": json_data(prediction.pv_nm),
                "form": _extremes(prediction),
                "tracking": tracking,
            }
        )
    return entries


def _extremes(prediction: Prediction) -> dict[str, dict[str, float]] | None:
    if prediction.form is None:
        return None
    return {"highest": prediction.form.highest._asdict(), "lowest": prediction.form.lowest._asdict()}


def _save(file: Path, values: Floats) -> None:
    with atomic_file(file) as stream:
        np.save(stream, values)


def _write_h5(result: Result, job: str, numbers: str, file: Path) -> None:
    """Write the HDF5 archive: job and numbers as text; maps, path and motion as arrays with units."""
    import h5py  # noqa: PLC0415 - slow import

    image = io.BytesIO()  # HDF5 itself can crash on a full disk
    with h5py.File(image, "w") as archive:
        archive.attrs["turnwright"] = __version__
        archive.attrs["job"] = job
        archive.attrs["result"] = numbers
        for prediction in result.predictions:
            group = archive.create_group(f"maps/{prediction.name.replace('/', '-')}")
            group.attrs["name"] = prediction.name
            _store(group, _fields(prediction.error, "z", *AXES))
            if prediction.tracking is not None:
                _store(group, {"tracking": prediction.tracking.z})
        for name, chips in result.chips.items():
            _store(archive.create_group(f"chips/{name}"), _fields(chips, *_field_names(chips, but="feed")))
        names = ("angle", "radius", "z", "sweep", "contact_x", "contact_y", "contact_z", "clearance")
        _store(archive.create_group("path"), _fields(result.path, *names))
        motions = {"motion": result.motion, **{f"turns/{n}": turn for n, turn in enumerate(result.revolutions, 1)}}
        for name, motion in motions.items():
            _store(archive.create_group(name), {"time": motion.time, **motion.axes})
    write_atomic(file, image.getbuffer())


def _store(group: Any, arrays: Mapping[str, Floats | None]) -> None:
    for name, values in arrays.items():
        if values is not None:
            unit = ARRAY_UNITS.get(name, "mm")
            group.create_dataset(name, data=values).attrs["unit"] = unit


def read_maps(path: str | PathLike[str]) -> dict[str, HeightMap]:
    """Read the error maps of a run archive, ``run.h5``.

    Raises
    ------
    InputError
        If the file is not a run archive.
    """
    import h5py  # noqa: PLC0415

    try:
        with h5py.File(path) as archive:
            return {
                group.attrs["name"]: HeightMap(
                    z=group["z"][:], name=group.attrs["name"], **{key: group[key][:] for key in AXES if key in group}
                )
                for group in archive["maps"].values()
            }
    except (OSError, KeyError) as error:
        raise InputError(f"{str(path)!r} is not the run.h5 of a run ({error})") from error
