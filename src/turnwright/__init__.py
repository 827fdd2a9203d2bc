"""Turnwright: from an optical prescription to a proven program for a diamond-turning lathe, and back.

The public names. Each is imported when it is first asked for, so that ``import turnwright`` costs nothing.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turnwright.access import Access, AccessFinding, check_access
    from turnwright.contact import place
    from turnwright.edge_fit import EdgeFit, fit_edge, read_edge_trace
    from turnwright.errors import (
        DomainError,
        GougeError,
        InputError,
        JobError,
        LimitError,
        MapError,
        ProgramError,
        Stopped,
        TurnwrightError,
        UnitError,
    )
    from turnwright.files import read_map, write_map
    from turnwright.generation import generate, generate_points, generate_polar
    from turnwright.heightmap import HeightMap
    from turnwright.job import Comparison, Job, Plan, Result, Shares, compare, plan, predict, preview, run, shares
    from turnwright.machine import Axis, Controller, Convention, Machine
    from turnwright.metrology import (
        Bands,
        Despiked,
        Filled,
        Nesting,
        Roughness,
        despike,
        fill_holes,
        filter_map,
        keep_disc,
        remove_form,
        roughness,
        separate_bands,
        trim_edge,
    )
    from turnwright.metrology.registration import PoseCandidate, Registration, Undetermined, register
    from turnwright.motion import Limits, SpeedProfile, check_limits, drive
    from turnwright.part import Part
    from turnwright.path import Motion, Path, Spiral
    from turnwright.pose import Pose
    from turnwright.post import (
        FastToolFiles,
        ProgramFiles,
        ProgramHeader,
        ProgramInfo,
        ProgramWarning,
        inspect_nc,
        read_fast_tool,
        read_nc,
        read_table,
        write_fast_tool,
        write_nc,
    )
    from turnwright.response import FrequencyResponse, Response, SecondOrder, TransferFunction
    from turnwright.strategy import (
        AdaptiveToolServo,
        FastToolServo,
        HybridToolServo,
        QuasiEllipticalToolServo,
        SlowToolServo,
        Strategy,
        Valleys,
    )
    from turnwright.surface import (
        Biconic,
        Conic,
        EvenAsphere,
        Expression,
        Forbes,
        Gridded,
        LensArray,
        Placed,
        Plane,
        RadialPolynomial,
        SineGrid,
        Sphere,
        Sum,
        Surface,
        Toroid,
        XYPolynomial,
        Zernike,
    )
    from turnwright.tool import Tool, WavinessTable
    from turnwright.tracking import precorrect, track

_HOMES = {
    "access": ("Access", "AccessFinding", "check_access"),
    "contact": ("place",),
    "edge_fit": ("EdgeFit", "fit_edge", "read_edge_trace"),
    "errors": (
        "DomainError",
        "GougeError",
        "InputError",
        "JobError",
        "LimitError",
        "MapError",
        "ProgramError",
        "Stopped",
        "TurnwrightError",
        "UnitError",
    ),
    "files": ("read_map", "write_map"),
    "generation": ("generate", "generate_points", "generate_polar"),
    "heightmap": ("HeightMap",),
    "job": ("Comparison", "Job", "Plan", "Result", "Shares", "compare", "plan", "predict", "preview", "run", "shares"),
    "machine": ("Axis", "Controller", "Convention", "Machine"),
    "metrology": (
        "Bands",
        "Despiked",
        "Filled",
        "Nesting",
        "Roughness",
        "despike",
        "fill_holes",
        "filter_map",
        "keep_disc",
        "remove_form",
        "roughness",
        "separate_bands",
        "trim_edge",
    ),
    "metrology.registration": ("PoseCandidate", "Registration", "Undetermined", "register"),
    "motion": ("Limits", "SpeedProfile", "check_limits", "drive"),
    "part": ("Part",),
    "path": ("Motion", "Path", "Spiral"),
    "pose": ("Pose",),
    "post": (
        "FastToolFiles",
        "ProgramFiles",
        "ProgramHeader",
        "ProgramInfo",
        "ProgramWarning",
        "inspect_nc",
        "read_fast_tool",
        "read_nc",
        "read_table",
        "write_fast_tool",
        "write_nc",
    ),
    "response": ("FrequencyResponse", "Response", "SecondOrder", "TransferFunction"),
    "strategy": (
        "AdaptiveToolServo",
        "FastToolServo",
        "HybridToolServo",
        "QuasiEllipticalToolServo",
        "SlowToolServo",
        "Strategy",
        "Valleys",
    ),
    "surface": (
        "Biconic",
        "Conic",
        "EvenAsphere",
        "Expression",
        "Forbes",
        "Gridded",
        "LensArray",
        "Placed",
        "Plane",
        "RadialPolynomial",
        "SineGrid",
        "Sphere",
        "Sum",
        "Surface",
        "Toroid",
        "XYPolynomial",
        "Zernike",
    ),
    "tool": ("Tool", "WavinessTable"),
    "tracking": ("precorrect", "track"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__version__ = version("turnwright")

__all__ = [
    "Access",
    "AccessFinding",
    "AdaptiveToolServo",
    "Axis",
    "Bands",
    "Biconic",
    "Comparison",
    "Conic",
    "Controller",
    "Convention",
    "Despiked",
    "DomainError",
    "EdgeFit",
    "EvenAsphere",
    "Expression",
    "FastToolFiles",
    "FastToolServo",
    "Filled",
    "Forbes",
    "FrequencyResponse",
    "GougeError",
    "Gridded",
    "HeightMap",
    "HybridToolServo",
    "InputError",
    "Job",
    "JobError",
    "LensArray",
    "LimitError",
    "Limits",
    "Machine",
    "MapError",
    "Motion",
    "Nesting",
    "Part",
    "Path",
    "Placed",
    "Plan",
    "Plane",
    "Pose",
    "PoseCandidate",
    "ProgramError",
    "ProgramFiles",
    "ProgramHeader",
    "ProgramInfo",
    "ProgramWarning",
    "QuasiEllipticalToolServo",
    "RadialPolynomial",
    "Registration",
    "Response",
    "Result",
    "Roughness",
    "SecondOrder",
    "Shares",
    "SineGrid",
    "SlowToolServo",
    "SpeedProfile",
    "Sphere",
    "Spiral",
    "Stopped",
    "Strategy",
    "Sum",
    "Surface",
    "Tool",
    "Toroid",
    "TransferFunction",
    "TurnwrightError",
    "Undetermined",
    "UnitError",
    "Valleys",
    "WavinessTable",
    "XYPolynomial",
    "Zernike",
    "check_access",
    "check_limits",
    "compare",
    "despike",
    "drive",
    "fill_holes",
    "filter_map",
    "fit_edge",
    "generate",
    "generate_points",
    "generate_polar",
    "inspect_nc",
    "keep_disc",
    "place",
    "plan",
    "precorrect",
    "predict",
    "preview",
    "read_edge_trace",
    "read_fast_tool",
    "read_map",
    "read_nc",
    "read_table",
    "register",
    "remove_form",
    "roughness",
    "run",
    "separate_bands",
    "shares",
    "track",
    "trim_edge",
    "write_fast_tool",
    "write_map",
    "write_nc",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"turnwright has no public name {name!r}: see turnwright.__all__")
    value = getattr(import_module(f"turnwright.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
