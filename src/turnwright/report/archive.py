"""Result files of a run next to its program: JSON numbers, NumPy maps and one HDF5 archive.

``result.json`` (numbers in mm, rad, s and N unless the name ends in a unit; ``null`` for infinite or undefined values)
has the keys

``schema``, ``turnwright``, ``ok``
    1; the version; whether the tool has access to the part and all machine limits are met.
``verdicts``, ``keeps_tolerances``
    One entry per stated tolerance and place: ``tolerance``, ``place``, ``limit_nm``, ``value_nm``, ``kept`` (``null``
    if it was not evaluated), ``reason``, ``sentence``; whether none is missed.
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
``rounding_nm``, ``rounding_limit_nm``
    Largest difference between the surfaces of the program on disk and of the planned motion, and its limit.
``warnings``, ``timings``, ``peak_memory_gb``
    Sentences; wall time of each stage; largest resident memory.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright import __version__
from turnwright._io import whole_file, write_whole
from turnwright.errors import InputError
from turnwright.files import write_map
from turnwright.heightmap import HeightMap
from turnwright.post import entry_words

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from os import PathLike

    from turnwright._arrays import Floats
    from turnwright.diagnosis import Diagnosis
    from turnwright.job import Comparison, Correction, Measured, Prediction, Result
    from turnwright.metrology import Roughness, Spectrum
    from turnwright.path import Motion
    from turnwright.studies import TiledMap

__all__ = [
    "archive_comparison",
    "archive_correction",
    "archive_diagnosis",
    "archive_measured",
    "archive_run",
    "archive_tiled",
    "read_maps",
    "write_maps",
]

AXES = ("x", "y", "radius", "angle")

ARRAY_UNITS = {
    **dict.fromkeys(("angle", "sweep", "C", "sweep_low", "sweep_high", "rake"), "rad"),
    **dict.fromkeys(("axial", "radial", "cutting"), "N"),
    **dict.fromkeys(("points", "inside"), "1"),
    "time": "s",
    "area": "mm^2",
}
"""Units of arrays in the archive; all others are in mm."""


def archive_run(result: Result, folder: str | PathLike[str]) -> None:
    """Write ``job.toml``, ``result.json``, ``maps/*.npy`` and ``run.h5``.

    Parameters
    ----------
    result
        Result of a run.
    folder
        Existing folder that holds the program files.
    """
    folder = Path(folder)
    job = result.job.to_toml()
    write_whole(folder / "job.toml", job)
    numbers = {
        "schema": 1,
        "turnwright": __version__,
        "ok": result.ok,
        "verdicts": [
            {
                "tolerance": one.tolerance,
                "place": one.place,
                "limit_nm": one.limit_nm,
                "value_nm": one.value_nm,
                "kept": one.is_kept,
                "reason": one.reason,
                "sentence": one.sentence,
            }
            for one in result.verdicts
        ],
        "keeps_tolerances": result.keeps_tolerances,
        "part": result.part.name,
        "machine": result.machine.name,
        "dialect": result.machine.dialect,
        "access": result.access,
        "passes": result.passes,
        "least_clearance": result.least_clearance,
        "program": {
            "files": [file.name for file in result.program.files],
            "lines": result.program.lines,
            "bytes": result.program.bytes,
            "minutes": result.program.minutes,
            "links_minutes": result.program.links_minutes,
            "entries": {name: entry_words(one) for name, one in result.program.approaches.items()},
            "hash": result.program.hash,
        },
        "predictions": write_maps(result.predictions, folder),
        "rounding_nm": result.rounding_nm,
        "rounding_limit_nm": result.rounding_limit_nm,
        "warnings": result.warnings,
        "timings": result.timings,
        "peak_memory_gb": result.peak_memory_gb,
    }
    text = json.dumps(_plain(numbers), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(folder / "result.json", text + "\n")
    _write_h5(result, job, text, folder / "run.h5")


def archive_comparison(found: Comparison, folder: str | PathLike[str]) -> None:
    """Write ``job.toml`` and ``comparison.json`` with all numbers of every strategy.

    Parameters
    ----------
    found
        Comparison of the strategies.
    folder
        Existing folder.
    """
    folder = Path(folder)
    write_whole(folder / "job.toml", found.job.to_toml())
    numbers = {
        "scallop": found.scallop,
        "chord": found.chord,
        "candidates": [
            {
                "name": one.name,
                "refused": one.refused,
                "strategy": found.stated(one),
                "turns": one.turns,
                "size_bytes": one.size_bytes,
                "limits": one.limits,
                "shares": None
                if one.shares is None
                else {part.name: getattr(one.shares, part.name) for part in fields(one.shares) if part.name != "error"},
                "wall_s": one.wall_s,
            }
            for one in found.candidates
        ],
    }
    _write_json(folder / "comparison.json", numbers)


def archive_tiled(made: TiledMap, rough: Roughness, spectrum: Spectrum, folder: str | PathLike[str]) -> None:
    """Write ``tiled.json`` and ``spectrum.csv``.

    Parameters
    ----------
    made, rough, spectrum
        Tiled map, its roughness and its spectrum.
    folder
        Existing folder.
    """
    folder = Path(folder)
    numbers = {
        "map": {"shape": list(made.shape), "pixel_mm": list(made.pixel), "extent_mm": list(made.extent)},
        "roughness": rough,
    }
    _write_json(folder / "tiled.json", numbers)
    unit = spectrum.unit.replace("²", "2").replace(" ", "_")
    lines = (f"{f:.17g},{density:.17g}" for f, density in zip(spectrum.frequency, spectrum.density, strict=True))
    table = [f"frequency_per_mm,density_{unit}", *lines]
    write_whole(folder / "spectrum.csv", "\n".join(table) + "\n")


def archive_measured(measured: Measured, folder: str | PathLike[str]) -> None:
    """Write ``measured.json``, ``error.npz`` (error over the part) and, for a lens array, ``lenslets.csv``.

    Parameters
    ----------
    measured
        Registered measurement of a part.
    folder
        Existing folder.
    """
    folder = Path(folder)
    write_map(measured.error, folder / "error.npz")
    if measured.lenslets is not None:
        write_whole(folder / "lenslets.csv", measured.lenslets.csv())
    _write_json(folder / "measured.json", {"part": measured.job.part.name, **_measured_numbers(measured)})


def _measured_numbers(measured: Measured) -> dict[str, object]:
    """Return the numbers of a measured part."""
    registration, terms = measured.registration, measured.zernike
    return {
        "name": measured.heights.name,
        "form_pv_nm": measured.form_pv_nm,
        "form_rms_nm": measured.form_rms_nm,
        "spikes": measured.outliers,
        "registration": {
            "pose": registration.pose,
            "pivot": registration.pivot,
            "std": registration.std,
            "held": registration.held,
            "count": registration.count,
            "lost": registration.lost,
            "rms_nm": registration.rms_nm,
            "noise_nm": registration.noise_nm,
            "correlated_nm": registration.correlated_nm,
            "correlation_length": registration.correlation_length,
            "candidates": registration.candidates,
            "sentences": (registration.sentences[0], *measured.open_questions),
        },
        "zernike": None
        if terms is None
        else {
            "indexing": terms.indexing,
            "radius": terms.radius,
            "indices": terms.indices,
            "coefficients": terms.coefficients.tolist(),
            "uncertainty": terms.uncertainty.tolist(),
        },
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


def archive_diagnosis(measured: Sequence[Measured], found: Diagnosis, folder: str | PathLike[str]) -> None:
    """Write ``diagnosis.json`` and the residual of each map as ``left-1.npz``, ``left-2.npz`` ...

    Parameters
    ----------
    measured, found
        Measured parts and their diagnosis.
    folder
        Existing folder.
    """
    folder = Path(folder)
    for number, residual in enumerate(found.residuals, 1):
        write_map(residual, folder / f"left-{number}.npz")
    _write_json(folder / "diagnosis.json", _diagnosis_numbers(measured, found))


def _diagnosis_numbers(measured: Sequence[Measured], diagnosis: Diagnosis) -> dict[str, object]:
    """Return the numbers of a diagnosis."""
    return {
        "measured": [_measured_numbers(part) for part in measured],
        "findings": list(diagnosis),
        "contributions": list(diagnosis.contributions),
        "names": diagnosis.names,
        "correlation": diagnosis.correlation.tolist(),
        "measured_rms_nm": diagnosis.measured_rms_nm,
        "explained_rms_nm": diagnosis.explained_rms_nm,
        "unexplained_rms_nm": diagnosis.unexplained_rms_nm,
        "noise_nm": diagnosis.noise_nm,
        "repeatability_nm": diagnosis.repeatability_nm,
    }


def archive_correction(
    measured: Sequence[Measured], found: Diagnosis, better: Correction, folder: str | PathLike[str]
) -> None:
    """Write ``correction.json`` and ``predicted.npz`` to the folder of the corrected job.

    Parameters
    ----------
    measured, found, better
        Measured parts, their diagnosis and the correction.
    folder
        Existing folder.
    """
    folder = Path(folder)
    write_map(better.simulated if better.predicted is None else better.predicted, folder / "predicted.npz")
    numbers = {name: {"pv_nm": pv, "rms_nm": rms} for name, (pv, rms) in better.numbers_nm.items()}
    summary = {
        "cutoff": better.cutoff,
        "sources": better.sources,
        "proof": better.proof,
        "sentences": better.sentences,
    }
    _write_json(folder / "correction.json", {**summary, **numbers, **_diagnosis_numbers(measured, found)})


def _write_json(file: Path, numbers: Mapping[str, object]) -> None:
    """Write numbers with the schema and the version."""
    document = {"schema": 1, "turnwright": __version__, **numbers}
    write_whole(file, json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_maps(predictions: Iterable[Prediction], folder: str | PathLike[str]) -> list[dict[str, Any]]:
    """Write the heights and axes of maps as ``maps/NAME.npy``, ``maps/NAME.x.npy`` ...

    Returns
    -------
    list
        Their entries in ``result.json``.
    """
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
                "roughness": _plain(prediction.roughness),
                "pv_nm": _plain(prediction.pv_nm),
                "form": _extremes(prediction),
                "tracking": tracking,
            }
        )
    return entries


def _extremes(prediction: Prediction) -> dict[str, dict[str, float]] | None:
    """Return the highest and the lowest point of the whole part."""
    if prediction.form is None:
        return None
    return {"highest": prediction.form.highest._asdict(), "lowest": prediction.form.lowest._asdict()}


def _save(file: Path, values: Floats) -> None:
    with whole_file(file) as stream:
        np.save(stream, values)


def _plain(value: object) -> object:
    """Convert a value to JSON types; non-finite numbers become ``None``."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
            _store(group, {"z": prediction.error.z} | {name: getattr(prediction.error, name) for name in AXES})
            if prediction.tracking is not None:
                _store(group, {"tracking": prediction.tracking.z})
        for name, chips in result.chips.items():
            arrays = {item.name: getattr(chips, item.name) for item in fields(chips) if item.name != "feed"}
            _store(archive.create_group(f"chips/{name}"), arrays)
        names = ("angle", "radius", "z", "sweep", "contact_x", "contact_y", "contact_z", "clearance")
        _store(archive.create_group("path"), {name: getattr(result.path, name) for name in names})
        _store_motion(archive.create_group("motion"), result.motion)
        for number, turn in enumerate(result.revolutions, 1):
            _store_motion(archive.create_group(f"turns/{number}"), turn)
    write_whole(file, image.getbuffer())


def _store_motion(group: Any, motion: Motion) -> None:
    _store(group, {"time": motion.time, **motion.axes})


def _store(group: Any, arrays: Mapping[str, Floats | None]) -> None:
    for name, values in arrays.items():
        if values is not None:
            unit = ARRAY_UNITS.get(name, "mm")
            group.create_dataset(name, data=values).attrs["unit"] = unit


def read_maps(path: str | PathLike[str]) -> dict[str, HeightMap]:
    """Read the error maps of a run archive.

    Parameters
    ----------
    path
        ``run.h5``.

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
