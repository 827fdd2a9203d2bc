"""What a run leaves on disk beside its program: numbers for programs, maps for any program, one archive of it all.

``result.json`` (numbers in mm, rad, s and N unless a name wears its unit; ``null`` for what is infinite or cannot be
stated) has the keys

``schema``, ``turnwright``, ``ok``
    1; the version; whether the tool reaches the part and the machine keeps all its limits.
``verdicts``, ``keeps_tolerances``
    One entry per stated tolerance and place: ``tolerance``, ``place``, ``limit_nm``, ``value_nm``, ``kept`` (``null``
    if it was not judged), ``reason``, ``sentence``; whether none is missed.
``part``, ``machine``, ``dialect``
    Names.
``access``
    The fields of `turnwright.access.Access`, ``findings`` with their sentences.
``passes``
    One entry per pass: the fields of `turnwright.job.Pass`, ``limits`` with the fields of `turnwright.motion.Limits`.
``least_clearance``
    Least height of the edge above the surface over the finishing path.
``program``
    The file names, main program first, lines, bytes, minutes of the cuts and of the links between them, how the tool
    enters the material of each pass, and the hash of all its points.
``predictions``
    One entry per map: ``name``, ``file`` of the heights (cut minus design, mm), ``axes`` (files by name), ``shape`` and
    ``roughness`` with the fields of `turnwright.metrology.Roughness`. ``pv_nm`` is what is judged: of the whole part
    from its highest to its lowest place, which ``form`` has with ``x``, ``y`` and ``error`` in mm (``null`` for a
    patch; then it is that of ``roughness``). ``tracking`` is ``null`` unless the servos were simulated; then it has the
    ``file`` of what they add to the heights (mm), and its ``pv_nm`` and ``rms_nm``.
``rounding_nm``, ``rounding_limit_nm``
    How far the surfaces of the program on disk and of the motion in memory are apart, and how far they may be.
``warnings``, ``timings``, ``peak_memory_gb``
    Sentences; wall time of each stage; largest resident memory.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
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

UNITS = {
    **dict.fromkeys(("angle", "sweep", "C", "sweep_low", "sweep_high", "rake"), "rad"),
    **dict.fromkeys(("axial", "radial", "cutting"), "N"),
    **dict.fromkeys(("points", "inside"), "1"),
    "time": "s",
    "area": "mm^2",
}
"""Units of arrays in the archive that are not in mm."""


def archive_run(result: Result, folder: str | PathLike[str]) -> None:
    """Write ``job.toml``, ``result.json``, ``maps/*.npy`` and ``run.h5`` into a folder that exists.

    Parameters
    ----------
    result
        What a run found out.
    folder
        Where to; the program's files are there already.
    """
    folder = Path(folder)
    job = result.job.to_toml()
    write_whole(folder / "job.toml", job)
    numbers = {
        "schema": 1,
        "turnwright": __version__,
        "ok": result.ok,
        "verdicts": [{**asdict(one), "sentence": one.sentence} for one in result.verdicts],
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
    """Write ``job.toml`` and ``comparison.json``, all numbers of every strategy, into a folder that exists.

    Parameters
    ----------
    found
        What the strategies make of a job.
    folder
        Where to.
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
        A map in tiles, and what was found in it.
    folder
        Where to; it exists.
    """
    folder = Path(folder)
    numbers = {
        "map": {"shape": list(made.shape), "pixel_mm": list(made.pixel), "extent_mm": list(made.extent)},
        "roughness": rough,
    }
    _write_json(folder / "tiled.json", numbers)
    unit = spectrum.unit.replace("²", "2").replace(" ", "_")
    lines = (f"{one:.17g},{two:.17g}" for one, two in zip(spectrum.frequency, spectrum.density, strict=True))
    table = [f"frequency_per_mm,density_{unit}", *lines]
    write_whole(folder / "spectrum.csv", "\n".join(table) + "\n")


def archive_measured(measured: Measured, folder: str | PathLike[str]) -> None:
    """Write ``measured.json``, ``error.npz`` (cut minus design over the part) and ``lenslets.csv``, if there are any.

    Parameters
    ----------
    measured
        How far a part is off.
    folder
        Where to; it exists.
    """
    folder = Path(folder)
    write_map(measured.error, folder / "error.npz")
    if measured.lenslets is not None:
        write_whole(folder / "lenslets.csv", measured.lenslets.csv())
    _write_json(folder / "measured.json", {"part": measured.job.part.name, **_measured_numbers(measured)})


def _measured_numbers(measured: Measured) -> dict[str, object]:
    """Return what is said of a measured part in numbers."""
    found, terms = measured.registration, measured.zernike
    return {
        "name": measured.heights.name,
        "form_pv_nm": measured.form_pv_nm,
        "form_rms_nm": measured.form_rms_nm,
        "spikes": measured.spikes,
        "registration": {
            "pose": found.pose,
            "pivot": found.pivot,
            "std": found.std,
            "held": found.held,
            "count": found.count,
            "lost": found.lost,
            "rms_nm": found.rms_nm,
            "noise_nm": found.noise_nm,
            "correlated_nm": found.correlated_nm,
            "correlation_length": found.correlation_length,
            "candidates": found.candidates,
            "sentences": (found.sentences[0], *measured.open_questions),
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
        "seen_design_nm": measured.seen_design_nm,
        "texture": measured.texture,
        "base_form": _base_form(measured),
    }


def _base_form(measured: Measured) -> dict[str, object] | None:
    """Return the height at the rim of each Zernike term (ANSI) of the base of a lens array. [mm]."""
    found = measured.lenslets
    if found is None or found.base_form is None:
        return None
    return {
        str(number): {"height": value, "std": found.base_form_std[number]}
        for number, value in dict(found.base_form.terms).items()
    }


def archive_diagnosis(measured: Sequence[Measured], found: Diagnosis, folder: str | PathLike[str]) -> None:
    """Write ``diagnosis.json`` and, for each map, what is left of it as ``left-1.npz`` and so on.

    Parameters
    ----------
    measured, found
        What was measured, and why it is off.
    folder
        Where to; it exists.
    """
    folder = Path(folder)
    for number, left in enumerate(found.residuals, 1):
        write_map(left, folder / f"left-{number}.npz")
    _write_json(folder / "diagnosis.json", _diagnosis_numbers(measured, found))


def _diagnosis_numbers(measured: Sequence[Measured], found: Diagnosis) -> dict[str, object]:
    """Return what is said of the causes in numbers."""
    return {
        "measured": [_measured_numbers(one) for one in measured],
        "findings": list(found),
        "contributions": list(found.contributions),
        "names": found.names,
        "correlation": found.correlation.tolist(),
        "measured_rms_nm": found.measured_rms_nm,
        "explained_rms_nm": found.explained_rms_nm,
        "unexplained_rms_nm": found.unexplained_rms_nm,
        "noise_nm": found.noise_nm,
        "repeatability_nm": found.repeatability_nm,
    }


def archive_correction(
    measured: Sequence[Measured], found: Diagnosis, better: Correction, folder: str | PathLike[str]
) -> None:
    """Write ``correction.json`` and ``predicted.npz``, beside the job that `turnwright.correct` has written.

    Parameters
    ----------
    measured, found, better
        What was measured, why it is off, and what was made of it.
    folder
        Where to; it exists.
    """
    folder = Path(folder)
    write_map(better.simulated if better.predicted is None else better.predicted, folder / "predicted.npz")
    numbers = {name: {"pv_nm": pv, "rms_nm": rms} for name, (pv, rms) in better.numbers_nm.items()}
    told = {
        "cutoff": better.cutoff,
        "sources": better.sources,
        "proof": better.proof,
        "sentences": better.sentences,
    }
    _write_json(folder / "correction.json", {**told, **numbers, **_diagnosis_numbers(measured, found)})


def _write_json(file: Path, numbers: Mapping[str, object]) -> None:
    """Write numbers with the version that they are of."""
    whole = {"schema": 1, "turnwright": __version__, **numbers}
    write_whole(file, json.dumps(_plain(whole), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_maps(predictions: Iterable[Prediction], folder: str | PathLike[str]) -> list[dict[str, Any]]:
    """Write the heights and the axes of maps as ``maps/NAME.npy`` and ``maps/NAME.x.npy`` and so on.

    Returns
    -------
    list
        What ``result.json`` says about them.
    """
    told = []
    (Path(folder) / "maps").mkdir()
    for one in predictions:
        stem = f"maps/{re.sub('[^A-Za-z0-9_-]+', '-', one.name)}"
        axes = {name: f"{stem}.{name}.npy" for name in AXES if getattr(one.error, name) is not None}
        _save(Path(folder) / f"{stem}.npy", one.error.z)
        for name, file in axes.items():
            _save(Path(folder) / file, getattr(one.error, name))
        tracking = None
        if one.tracking is not None and one.tracking_nm is not None:
            pv, rms = one.tracking_nm
            tracking = {"file": f"{stem}.tracking.npy", "pv_nm": pv, "rms_nm": rms}
            _save(Path(folder) / f"{stem}.tracking.npy", one.tracking.z)
        told.append(
            {
                "name": one.name,
                "file": f"{stem}.npy",
                "axes": axes,
                "shape": one.error.z.shape,
                "roughness": _plain(one.roughness),
                "pv_nm": _plain(one.pv_nm),
                "form": _extremes(one),
                "tracking": tracking,
            }
        )
    return told


def _extremes(one: Prediction) -> dict[str, dict[str, float]] | None:
    """Return the highest and the lowest place of the whole part."""
    if one.form is None:
        return None
    return {"highest": one.form.highest._asdict(), "lowest": one.form.lowest._asdict()}


def _save(file: Path, values: Floats) -> None:
    with whole_file(file) as stream:
        np.save(stream, values)


def _plain(value: object) -> object:
    """Return a value as JSON takes it; arrays are left to the maps."""
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
    """Write the archive: the job and the numbers as text, maps, path and motion as arrays with their units."""
    import h5py  # noqa: PLC0415 - costly, and only a run needs it

    image = io.BytesIO()  # HDF5 itself does not survive a full disk
    with h5py.File(image, "w") as archive:
        archive.attrs["turnwright"] = __version__
        archive.attrs["job"] = job
        archive.attrs["result"] = numbers
        for one in result.predictions:
            group = archive.create_group(f"maps/{one.name.replace('/', '-')}")
            group.attrs["name"] = one.name
            _store(group, {"z": one.error.z} | {name: getattr(one.error, name) for name in AXES})
            if one.tracking is not None:
                _store(group, {"tracking": one.tracking.z})
        for name, chips in result.chips.items():
            told = {item.name: getattr(chips, item.name) for item in fields(chips) if item.name != "feed"}
            _store(archive.create_group(f"chips/{name}"), told)
        names = ("angle", "radius", "z", "sweep", "contact_x", "contact_y", "contact_z", "clearance")
        _store(archive.create_group("path"), {name: getattr(result.path, name) for name in names})
        _store_motion(archive.create_group("motion"), result.motion)
        for number, turn in enumerate(result.turns, 1):
            _store_motion(archive.create_group(f"turns/{number}"), turn)
    write_whole(file, image.getbuffer())


def _store_motion(group: Any, motion: Motion) -> None:
    _store(group, {"time": motion.time, **motion.axes})


def _store(group: Any, arrays: Mapping[str, Floats | None]) -> None:
    for name, values in arrays.items():
        if values is not None:
            unit = UNITS.get(name, "mm")
            group.create_dataset(name, data=values).attrs["unit"] = unit


def read_maps(path: str | PathLike[str]) -> dict[str, HeightMap]:
    """Read the error maps of a run archive back.

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
        raise InputError(f"{str(path)!r} is not a run archive ({error}): give the run.h5 of a run") from error
