"""Keys of the table ``measurement`` that determine what a registration could not."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

import numpy as np

from turnwright.job.schema import MeasurementTable
from turnwright.metrology import DoubtKind, PoseCandidate, Registration

__all__ = ["open_questions"]

MIN_REACH_MM = 0.01
"""Least distance of two poses that a stated ``reach`` separates in practice. [mm]."""

MIN_CLOCKING_RAD = np.deg2rad(0.01)
"""Least rotation between two poses that a stated ``clocking`` separates in practice. [rad]."""

EDGE_FRACTION = 0.01
"""First width of an edge to leave out, over the clear semi-diameter."""


def open_questions(registration: Registration, settings: MeasurementTable, radius: float) -> tuple[str, ...]:
    """Return what a registration could not determine, a sentence each with the keys of ``[measurement]`` for it."""
    remedies: dict[DoubtKind, Callable[[], str]] = {
        "tails": lambda: _trim(settings, radius),
        "lost": lambda: _larger(settings),
        "held": lambda: _hold(registration, settings),
        "ambiguous": lambda: _single_out(registration, registration.rivals[0]),
        "symmetric": lambda: _clock(registration),
    }
    return tuple(f"{fact} {remedies[kind]()}" if kind in remedies else fact for kind, fact in registration.findings)


def _length(value: float) -> str:
    return f"{round(value, 4) + 0.0:.6g} mm"


def _degrees(value: float) -> str:
    return f"{round(float(np.rad2deg(value)), 3) + 0.0:.6g} deg"


def _keys(keys: Mapping[str, object]) -> str:
    """Return keys in the syntax of a job file."""
    return ", ".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())


def _shift(registration: Registration) -> list[str]:
    return [_length(one) for one in registration.pose.shift]


def _trim(settings: MeasurementTable, radius: float) -> str:
    keys: dict[str, object] = {"trim": _length(max(2 * settings.trim, EDGE_FRACTION * radius))}
    if settings.outliers != "robust":
        keys = {"outliers": "robust", **keys}
    return f"Write {_keys(keys)} in [measurement], or state mirrored or inverted if the map is so."


def _larger(settings: MeasurementTable) -> str:
    return (
        "Unless these points lie beyond the rim of the part, state shift and rotation of the map, and a reach of more "
        f"than {_length(settings.reach)}, in [measurement]."
    )


def _hold(registration: Registration, settings: MeasurementTable) -> str:
    keys: dict[str, object] = {"free": [name for name in settings.free if name not in registration.held]}
    if {"x", "y", "z"} & set(registration.held):
        keys["shift"] = _shift(registration)
    if "rotation" in registration.held:
        keys["rotation"] = _degrees(registration.pose.rotation)
    if not keys["free"]:
        return "Measure the edge of the part or a fiducial, and state shift and rotation in [measurement]."
    return (
        f"Check it by the edge of the part or a fiducial, and write {_keys(keys)} in [measurement], or the true values."
    )


def _turn(registration: Registration, other: PoseCandidate) -> float:
    """Return the rotation between another pose and that of the registration. [rad]."""
    return float(abs((other.pose.rotation - registration.pose.rotation + np.pi) % (2 * np.pi) - np.pi))


def _single_out(registration: Registration, rival: PoseCandidate) -> str:
    pivot, rival_pivot = (np.array(pose.apply(*registration.pivot))[:2] for pose in (registration.pose, rival.pose))
    distance, turned = float(np.hypot(*(pivot - rival_pivot))), _turn(registration, rival)
    keys: dict[str, object] = {"shift": _shift(registration), "rotation": _degrees(registration.pose.rotation)}
    if distance > MIN_REACH_MM:
        keys["reach"] = _length(distance / 2)
    if turned > MIN_CLOCKING_RAD:
        keys["clocking"] = _degrees(turned / 2)
    return (
        f"Measure the edge of the part or a fiducial; if this pose is right, write {_keys(keys)} in [measurement], "
        "otherwise the shift and rotation of the other pose."
    )


def _clock(registration: Registration) -> str:
    step = min(_turn(registration, other) for other in registration.candidates if other.symmetric)
    keys = {"rotation": _degrees(registration.pose.rotation), "clocking": _degrees(step / 2)}
    return f"Write {_keys(keys)} in [measurement], with the rotation of a fiducial."
