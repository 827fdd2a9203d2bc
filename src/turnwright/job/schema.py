"""The job file, as data only. Each table is documented with the class that it builds."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path as File
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeAlias, cast

import numpy as np
import tomli_w
from annotated_types import Ge, Le
from pydantic import Field, PlainValidator, Strict, ValidationError

from turnwright._arrays import Floats
from turnwright._faults import faults as faults_of, sentences
from turnwright._io import bytes_of, read_toml, write_atomic
from turnwright._tables import adapter, read_by, types_of, write_table
from turnwright._validate import check_index, check_numbers, check_obscuration, check_wavelength
from turnwright.chuck import Chuck
from turnwright.diagnosis import ERROR_SOURCES
from turnwright.errors import InputError, JobError
from turnwright.job.replacing import replace_field
from turnwright.job.tables import AnyInstrument, AnyMachine, ExistingFile, MachineDeviations, Table, context_of
from turnwright.machine import Machine
from turnwright.metrology import CallOut, read_call_out, require_consistent
from turnwright.motion import require_variable
from turnwright.optics import Removed
from turnwright.outline import BORDER_TOL
from turnwright.part import Part
from turnwright.pose import Pose
from turnwright.post import (
    FASTEST_PLUNGE,
    PLUNGE_FEED,
    Dialect,
    ProgramStart,
    WorkOffset,
    dialect_of,
    require_spindle_modes,
)
from turnwright.speed_profile import Speeds, check_one_speed
from turnwright.strategy import STRATEGIES, Strategy, Turning
from turnwright.surface import FAMILIES, Surface
from turnwright.tool import Tool, Waviness, WavinessTable
from turnwright.units import (
    NAME_PATTERN,
    Angle,
    Count,
    Feed,
    Flag,
    Length,
    Number,
    Size,
    Speed,
    Step,
    Text,
    Thickness,
    unit,
)

__all__ = ["Job", "PassTable", "faults"]

Name: TypeAlias = Annotated[str, Strict(), Field(pattern=NAME_PATTERN)]

Accepted: TypeAlias = Literal[
    "nose radius", "included angle", "clearance", "rake", "valley", "step", "shank", "holder", "limits", "gouge"
]

MAX_REPEATS = 100
"""Repetitions of one pass: a depth that needs more has a wrong unit."""

MAX_VALUES = 100_000
"""Values in all tables and lists of a job: heights and curves belong in their own files."""

MAX_SAMPLES = 1e8
"""Heights in one map: a pixel that gives more has a wrong unit."""

PATCH_SAMPLES = 33
"""Points along each side of a patch that must be on the outline of the part."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolDeviations(Table):
    """Deviations of the actual tool from the nominal tool.

    Parameters
    ----------
    waviness
        Radial deviation of the edge, positive outward: coefficients of the sweep on the nose, of its square and
        so on, such as "0.2 um/rad", "-1 um/rad^2".
    waviness_file
        File with the columns sweep and deviation, each with its unit in the header, in place of the coefficients.
    radius_error
        Actual minus nominal nose radius. [mm]
    offset
        Actual minus nominal position of the tip: along X (tool centring error), in height (tool height error), along
        Z. [mm]
    rake
        Rake angle; positive if the rake face leans back from the cutting direction. [rad]
    """

    waviness: Waviness | None = None
    waviness_file: Annotated[WavinessTable | None, read_by("waviness")] = None
    radius_error: Length | None = None
    offset: tuple[Length, Length, Length] | None = None
    rake: Angle | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """The deviations that the job states, as `Tool` takes them."""
        stated = {name: getattr(self, name) for name in ("waviness", "radius_error", "offset", "rake")}
        if self.waviness_file is not None:
            stated["waviness"] = self.waviness_file
        return {name: value for name, value in stated.items() if value is not None}

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.waviness is not None and self.waviness_file is not None:
            raise JobError("only one of waviness and waviness_file can be stated, got both: remove one")


NOT_CHOICES = ("name", "kind", "allowance", "depth", "tool", "tool_call")
"""Keys of a pass that replace no value of the strategy."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PassTable(Table):
    """One pass: values that differ from the strategy, its allowance and its depth of cut.

    Parameters
    ----------
    name
        Name of the pass in the program and in all results.
    kind
        "turning" for a roughing pass in spindle mode before a finish with C as an axis; it needs its own spindle speed
        and chord. It cuts a surface that is none of revolution at its highest height over the azimuth.
    feed
        Feed per revolution of the spindle, in this pass. [mm/rev]
    spindle_rpm
        Spindle speed in this pass; that of the strategy if left out. [rpm]
    spindle_speeds
        Spindle speeds, each with its radius, in this pass.
    points_per_rev
        Program points per revolution, in this pass.
    arc_length
        Distance between program points along the spiral, in this pass. [mm]
    max_step
        Largest angle between program points, in this pass. [rad]
    chord
        Largest chord error: distance of straight lines between points from the exact path, in this pass. [mm]
    lead_in
        Distance beyond the clear aperture at which the tip starts, in this pass. [mm]
    scallop
        Largest cusp height, in this pass. [mm]
    allowance
        Material left above the finished surface after the pass; the last pass leaves none. [mm]
    depth
        Depth of cut: the pass is repeated, each time deeper, until its allowance is reached; a single cut if left
        out. [mm]
    tool
        The tool of a roughing pass, if it is not that of the job.
    tool_call
        Words that call this tool with its offset, such as "T0202".
    """

    key_names = MappingProxyType({"spindle_rpm": "spindle_speed"})
    name: Name
    kind: Literal["turning"] | None = None
    feed: Feed | None = None
    spindle_rpm: Speed | None = None
    spindle_speeds: Speeds | None = None
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    chord: Size | None = None
    lead_in: Thickness | None = None
    scallop: Size | None = None
    allowance: Thickness = 0.0
    depth: Size | None = None
    tool: Tool | None = None
    tool_call: Text = ""

    @property
    def choices(self) -> dict[str, Any]:
        """The values of the strategy that the pass replaces."""
        names = (name for name in types_of(PassTable) if name not in NOT_CHOICES)
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def __post_init__(self) -> None:
        check_numbers(self)
        check_one_speed(self)

    def repeats(self, stock: float) -> int:
        """Return the number of repetitions of the pass that remove ``stock`` [mm] down to its allowance."""
        return max(1, math.ceil((stock - self.allowance) / self.depth - 1e-9)) if self.depth else 1

    def names(self, stock: float) -> list[str]:
        """Return the name of each repetition."""
        times = self.repeats(stock)
        return [self.name] if times == 1 else [f"{self.name} {number}" for number in range(1, times + 1)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Patch(Table):
    """A rectangle on the part where the surface is predicted.

    Parameters
    ----------
    name
        Name of the patch.
    centre
        Centre of the patch on the part (x, y). [mm]
    size
        Size along x and y. [mm]
    pixel
        Pixel size; a quarter of the feed or less resolves the cusps. [mm]
    """

    name: Name
    centre: tuple[Length, Length]
    size: tuple[Size, Size]
    pixel: Size

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """Coordinates of the columns and rows of the grid, centred, at exactly the pixel size. [mm]."""
        axes = []
        for middle, size in zip(self.centre, self.size, strict=True):
            count = math.floor(size / self.pixel + 1e-9) + 1
            if count < 2:
                raise JobError(
                    f"pixel must be at most the size of the patch, {size:g} mm, got {self.pixel:g} mm: reduce it"
                )
            axes.append(np.asarray(middle + (np.arange(count) - (count - 1) / 2) * self.pixel, dtype=np.float64))
        return axes[0], axes[1]

    @property
    def samples(self) -> tuple[Floats, Floats]:
        """Points over the patch and its sides, few enough to test whether it is on an outline. Each (n, n) [mm]."""
        x, y = np.meshgrid(*(np.linspace(one[0], one[-1], PATCH_SAMPLES) for one in self.axes))
        return x, y

    def __post_init__(self) -> None:
        check_numbers(self)
        points = math.prod(size / self.pixel + 1 for size in self.size)
        if points > MAX_SAMPLES:
            raise JobError(
                f"patch {self.name!r} has {points:.3g} points, the limit is {MAX_SAMPLES:.0e}: increase pixel"
            )
        _ = self.axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WholePart(Table):
    """The polar grid over the whole part.

    Parameters
    ----------
    radii
        Number of rings from the axis to the edge of the clear aperture.
    angles
        Number of heights on each ring.
    """

    radii: Annotated[int, Strict(), Ge(2)] = 400
    angles: Annotated[int, Strict(), Ge(3)] = 360

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.radii * self.angles > MAX_SAMPLES:
            raise JobError(
                f"radii times angles is {self.radii * self.angles}, the limit is {MAX_SAMPLES:.0e}: reduce them"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationTable(Table):
    """Which maps to predict, and whether to simulate the servos.

    Parameters
    ----------
    tracking
        Whether to simulate the response of the servos; otherwise the axes follow the program exactly.
    whole_part
        The polar map of the whole part.
    patches
        Small maps with a fine pixel, for the surface finish.
    """

    tracking: Flag = False
    whole_part: WholePart = WholePart()
    patches: tuple[Patch, ...] = ()


def _check_form(value: object) -> int | str:
    names = ("none", "mean", "plane", "sphere")
    if value in names or (isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 10):
        return value
    raise JobError(
        f"form removal must be one of {', '.join(names)}, or the degree of a polynomial, 0 to 10, got {value!r}"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoughnessTable(Table):
    """Form removal before the roughness of a patch is computed: see `turnwright.roughness`.

    Parameters
    ----------
    form
        "none", "mean", "plane", "sphere", or the degree of a polynomial, 0 to 10.
    """

    form: Annotated[int | str, PlainValidator(_check_form)] = "plane"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasurementTable(Table):
    """How the part is measured, and how its map is registered and corrected for: see `turnwright.measure`.

    A map that shows the part from the other side is ``mirrored`` left to right, one whose heights increase into the
    material is ``inverted``.

    Parameters
    ----------
    part
        Name of the part of the chuck that the map shows. The stated position and clocking are then those on this part.
    pixel_size
        Pixel size of the map, for a file that does not state it: one size, or one along x and one along y. [mm]
    units
        Unit of x and y of a text file that states none.
    sag_units
        Unit of the heights of such a file.
    quantity
        Content of the map: heights, or departures from a reference along z or along its normal.
    departure_from
        Reference of the departures: "design", or any prescription.
    mirrored
        Whether the map shows the part from the other side, left and right exchanged.
    inverted
        Whether its heights increase into the material.
    outliers
        Method of outlier removal.
    trim
        Width of the edge of the map that is left out. [mm]
    shift
        Approximate position of the centre of the map on the part, along x, y and z. [mm]
    rotation
        Approximate clocking of the map on the part. [rad]
    reach
        Largest distance of the map from its stated position. [mm]
    clocking
        Largest rotation of the map from its stated clocking. [rad]
    free
        Degrees of freedom of the pose that are fitted; the others keep their stated values.
    terms
        Forms whose amplitude is fitted along with the pose, each a prescription; see `turnwright.register`.
    form_error
        Largest low-order form error at the rim, for its effect on the pose. [mm]
    undetermined
        How to treat degrees of freedom that such a form error can imitate: "fit", "hold" at the stated pose, or
        "raise" an error.
    mask
        File with a map of the same grid: heights that are missing there, or 0 in a mask of 0 and 1, are ignored.
    instrument
        Instrument whose transfer function is applied to the design and to predicted cusps before the comparison: a
        name, a ``.toml`` file, or a table of its values. Values left out have no effect.
    loss
        Weighting of residuals: "linear", "huber" or "tukey"; if left out, robust until outliers are removed, then
        linear.
    noise
        Standard deviation of a height; estimated from the map if left out. [mm]
    calibration
        Expanded uncertainty (k = 2) of a difference of heights, by the calibration of the instrument. [mm]
    reference
        Reference surface of the form error.
    error_sources
        Error sources to look for; if left out, all that a single map can separate.
    fixed
        Degrees of freedom fixed by fiducials, so that they count as errors of the part.
    waviness
        Powers of the sweep used to fit the waviness of the edge.
    min_effect
        Least certain improvement of the rms for a correction, and least effect of a corrected error source. [mm]
    cutoff
        Shortest wavelength of the form correction; derived from part and feed if left out. [mm]
    correct
        Error sources for which tool and machine are corrected if they are certain, all if left out; the residual is
        compensated as form of the part.
    repeats
        Whether drift, and form error without a known source, of a single map are assumed to repeat on the next part.
    corrected
        Maps that this job was corrected with, as `correct` records them, so that none is applied twice.
    cut_by
        "this job", if this corrected job cut the measured part although its map still shows the corrected error.
    """

    part: Text = ""
    pixel_size: Size | tuple[Size, Size] | None = None
    units: Literal["m", "mm", "um", "in"] | None = None
    sag_units: Literal["m", "mm", "um", "nm", "in"] | None = None
    quantity: Literal["height", "departure", "departure, along the normal"] = "height"
    departure_from: Literal["design"] | Surface | None = None
    mirrored: Flag = False
    inverted: Flag = False
    outliers: Literal["robust", "second difference", "none"] = "robust"
    trim: Thickness = 0.0
    shift: tuple[Length, Length, Length] | None = None
    rotation: Angle | None = None
    reach: Thickness = 5.0
    clocking: Annotated[float, unit("rad", least=0.0)] = math.radians(30)
    free: tuple[Literal["x", "y", "z", "rotation", "tilt_x", "tilt_y"], ...] = (
        "x", "y", "z", "rotation", "tilt_x", "tilt_y",
    )  # fmt: skip
    terms: tuple[Surface, ...] = ()
    form_error: Thickness = 1e-3
    undetermined: Literal["fit", "hold", "raise"] = "fit"
    mask: ExistingFile | None = None
    instrument: AnyInstrument | None = None
    loss: Literal["linear", "huber", "tukey"] | None = None
    noise: Size | None = None
    calibration: Size | None = None
    reference: Literal["true form", "best-fit sphere", "best-fit sphere, along its normal"] = "true form"
    error_sources: tuple[Text, ...] | None = None
    fixed: tuple[Literal["piston", "tilt", "decentre", "clocking"], ...] = ()
    waviness: tuple[Annotated[int, Strict(), Ge(1), Le(9)], ...] = (3, 4, 5, 6)
    min_effect: Thickness = 1e-6
    cutoff: Size | None = None
    correct: tuple[Text, ...] | None = None
    repeats: Flag = True
    corrected: tuple[Text, ...] = ()
    cut_by: Literal["this job"] | None = None

    @property
    def height_noise(self) -> float | None:
        """Stated standard deviation of a height, that of the instrument if the job states none. [mm]."""
        return self.noise or (None if self.instrument is None else self.instrument.noise or None)

    @property
    def pose(self) -> Pose | None:
        """Approximate pose of the map on the part, if the job states one."""
        if self.shift is None and self.rotation is None:
            return None
        return Pose(shift=self.shift or (0.0, 0.0, 0.0), rotation=self.rotation or 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        for key in ("error_sources", "correct"):
            for error_source in getattr(self, key) or ():
                if error_source not in ERROR_SOURCES:
                    raise JobError(f"{key} must name some of {', '.join(ERROR_SOURCES)}, got {error_source!r}")
        if (self.quantity == "height") != (self.departure_from is None):
            raise JobError(
                f"quantity is {self.quantity!r} and departure_from is "
                f"{'missing' if self.departure_from is None else 'stated'}: a departure needs its reference, "
                '"design" or a prescription, a height must not have one'
            )
        for key in ("free", "error_sources", "waviness"):
            if (entries := getattr(self, key)) is not None and not entries:
                raise JobError(f"{key} needs at least 1 entry, got none: add one, or leave it out")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpticsTable(Table):
    """How light meets the surface, to predict its optical performance: see `turnwright.optics.wavefront`.

    Parameters
    ----------
    wavelength
        Wavelength of the light in air. [mm]
    index
        Refractive index of the material at this wavelength; left out for a mirror.
    source
        Height above the vertex of the point on the axis from which the light comes, or to which it converges;
        collimated along the axis if left out. [mm]
    inside
        Whether the light arrives through the material.
    obscuration
        Radius of the central obscuration over that of the clear aperture.
    focal_length
        Focal length for positions and frequencies in the image; angles if left out. [mm]
    remove
        What alignment removes from the wavefront: "none", "piston", "tilt" or "focus".
    """

    wavelength: Size
    index: Number | None = None
    source: Length | None = None
    inside: Flag = False
    obscuration: Number = 0.0
    focal_length: Size | None = None
    remove: Removed = "tilt"

    def __post_init__(self) -> None:
        check_numbers(self)
        try:
            check_wavelength(self.wavelength)
            check_obscuration(self.obscuration)
            _ = None if self.index is None else check_index(self.index)
        except InputError as error:
            raise JobError(str(error)) from error
        if self.inside and self.index is None:
            raise JobError("inside is true and there is no index, a mirror has no light inside: state the index")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CuspOrder(Table):
    """Tolerance of the light in diffraction orders of the cusps, anywhere on the part.

    Parameters
    ----------
    max
        Largest share of the light in one order other than the specular one.
    wavelength
        Wavelength of the light in air. [mm]
    index
        Refractive index of the material at this wavelength; left out for a mirror.
    """

    max: Number
    wavelength: Size
    index: Number | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        _ = self.light
        if not 0 < self.max < 1:
            raise JobError(f"max must be above 0 and below 1, got {self.max:g}: give a share of the light")

    @property
    def light(self) -> OpticsTable:
        """Collimated light of this wavelength."""
        return OpticsTable(wavelength=self.wavelength, index=self.index)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tolerances(Table):
    """Tolerances of the part; a missed tolerance becomes a warning.

    Parameters
    ----------
    form_pv
        Peak to valley of the form error over the whole part. [mm]
    sq
        Root mean square roughness Sq of each patch. [mm]
    cusp_order
        Light in each diffraction order of the cusps.
    drawing
        Call-outs as they are written on the drawing, after ISO 10110-5, -8 and -12 and ISO 21920, such as "3/
        0.5(0.2/0.1); λ = 546.07 nm" and "Ra 0.02".
    """

    form_pv: Size | None = None
    sq: Size | None = None
    cusp_order: CuspOrder | None = None
    drawing: tuple[Text, ...] = ()

    def __post_init__(self) -> None:
        check_numbers(self)
        try:
            require_consistent(self.call_outs)
        except InputError as error:
            raise JobError(f"drawing: {error}") from error

    @property
    def call_outs(self) -> tuple[CallOut, ...]:
        """The call-outs of the drawing."""
        return tuple(read_call_out(text) for text in self.drawing)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actual(Table):
    """Deviations of the actual tool and machine, for the simulation.

    Parameters
    ----------
    tool
        Deviations of the actual tool from the nominal tool.
    machine
        Deviations of the actual machine from the nominal machine.
    """

    tool: ToolDeviations = ToolDeviations()
    machine: MachineDeviations = MachineDeviations()  # noqa: RUF009 - frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramTable(Table):
    """How the program is written.

    Parameters
    ----------
    name
        Name of the program files, without extension.
    max_lines
        Most lines in one file; the limit of the controller if left out.
    fast_tool
        How the fast tool reads its table: by position of the spindle, or by time.
    fast_tool_rate
        Heights per second of a table by time. [Hz]
    precorrect
        Whether the program compensates the predicted tracking errors of the servos.
    work_offset
        Work offset that the program selects; the operator selects it if left out.
    tool_call
        Words that call the tool with its offset, such as "T0101"; the operator selects it if left out.
    auxiliary
        Functions that are on during the program, by their names in the dialect, such as "mist".
    dry_run
        Height by which a second program, NAME-dry, runs above the first, to try it in air. [mm]
    lead_out
        Height to which the tool leaves the part at the end of a pass while C goes on turning; without it the tool ends
        on the part at rest. Not needed in spindle mode, or where a pass ends in air. [mm]
    change_height
        Height above the clear plane of the passes at which the tool is changed, where they use several tools. [mm]
    plunge_feed
        Fastest plunge into the material while C turns, where a pass cannot begin outside the blank. [mm/s]
    """

    name: Annotated[str, Strict(), Field(pattern=r"^[A-Za-z0-9_-]{1,30}$")] = "part"
    max_lines: Annotated[int, Strict(), Ge(100)] | None = None
    fast_tool: Literal["position", "time"] | None = None
    fast_tool_rate: Annotated[float, unit("Hz", above=0.0)] | None = None
    precorrect: Flag = False
    work_offset: WorkOffset | None = None
    tool_call: Text = ""
    auxiliary: tuple[Text, ...] = ()
    dry_run: Size | None = None
    lead_out: Size | None = None
    change_height: Size | None = None
    plunge_feed: Annotated[float, unit("mm/s", above=0.0)] = PLUNGE_FEED

    @property
    def start(self) -> ProgramStart:
        """What the program selects before its first move."""
        return ProgramStart(work_offset=self.work_offset or "", tool_call=self.tool_call, auxiliary=self.auxiliary)

    def __post_init__(self) -> None:
        check_numbers(self)
        _ = self.start
        if self.plunge_feed > FASTEST_PLUNGE:
            raise JobError(
                f"plunge_feed is {self.plunge_feed * 60:g} mm/min, the limit is {FASTEST_PLUNGE * 60:g} mm/min: check "
                "its unit"
            )


def _require_unique(what: str, names: list[str]) -> None:
    """Raise if two names would give the same file name."""
    alike = [re.sub("[ -]+", "-", name).casefold() for name in names]
    for name, plain in zip(names, alike, strict=True):
        if alike.count(plain) > 1:
            raise JobError(
                f"names in {what} must differ as file names, {name!r} occurs {alike.count(plain)} times: rename one"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job(Table):
    """A job: everything that a run needs, as data. It is checked when it is created.

    Parameters
    ----------
    part, tool, machine, strategy
        The part, the tool and the machine to cut it with, and the strategy of the tool path.
    passes
        In the order of cutting, the last one leaves no allowance; one pass named "finish" if not given.
    simulation, actual
        Maps to predict, and deviations of the actual tool and machine.
    roughness, tolerances
        Form removal before roughness is computed, and tolerances of the part.
    measurement
        How the part is measured.
    optics
        How light meets the surface; its optical performance is predicted if stated.
    program
        How the program is written.
    accept
        Findings that are accepted: those of `check_access` by name, "limits" of the machine, "gouge" of a path along
        the normal or of the predicted surface. Accepted findings are warnings, all others end the run.

    Raises
    ------
    JobError
        One line for each invalid field.

    >>> job = Job.read({
    ...     "part": {"surface": {"family": "sphere", "radius": "61.5 mm"}, "radius": "5 mm"},
    ...     "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    ...     "machine": {"name": "generic"},
    ...     "strategy": {"kind": "slow tool servo", "feed": "8 um/rev", "points_per_rev": 360},
    ... })
    >>> job.strategy.feed
    0.008
    """

    part: Part
    tool: Tool
    machine: AnyMachine
    strategy: Strategy
    passes: tuple[PassTable, ...] = (PassTable(name="finish"),)
    simulation: SimulationTable = SimulationTable()
    actual: Actual = Actual()
    roughness: RoughnessTable = RoughnessTable()
    tolerances: Tolerances = Tolerances()
    measurement: MeasurementTable = MeasurementTable()
    optics: OpticsTable | None = None
    program: ProgramTable = ProgramTable()
    accept: tuple[Accepted, ...] = ()

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Reject a table with too many values, before each of them is validated."""
        count, waiting = 0, [cast("object", table)]
        while waiting:
            one = waiting.pop()
            if isinstance(one, dict | list | tuple):
                count += len(one)
                if count > MAX_VALUES:
                    raise JobError(
                        f"a job can have at most {MAX_VALUES:,} values, this one has more: store long tables of "
                        "numbers in separate files and state their names"
                    )
                waiting.extend(one.values() if isinstance(one, dict) else one)
        return table

    def __post_init__(self) -> None:
        check_numbers(self)
        try:
            dialect = dialect_of(self.machine)
        except InputError as error:
            raise JobError(f"machine: {error}") from error
        try:
            self.program.start.lines(dialect)
        except InputError as error:
            raise JobError(f"program: {error}") from error
        self._check_passes()
        self._check_servos()
        self._check_dry_run()
        if self.program.precorrect and self.program.lead_out is not None:
            raise JobError(
                "program.lead_out and precorrect are stated, the servos cannot be corrected for a rise of few blocks: "
                "leave one out"
            )
        self._check_tools(dialect)
        if self.optics is not None and isinstance(self.part.surface, Chuck):
            raise JobError(
                f"optics is stated, the part is a chuck of {len(self.part.surface.parts)}: state it in the job of one "
                "part alone"
            )

    def _check_passes(self) -> None:
        """Raise unless each pass cuts deeper than the one before, and all patches are on the part."""
        if not self.passes:
            raise JobError(
                "passes needs at least 1 entry, got none: add one, or leave it out for a single finishing pass"
            )
        allowance, names = self.part.stock, []
        for number, cut in enumerate(self.passes, 1):
            if cut.allowance > allowance:
                raise JobError(
                    f"passes[{number}].allowance is {cut.allowance:g} mm, the limit is the material before the pass, "
                    f"{allowance:g} mm: reduce it, or state part.stock"
                )
            if cut.repeats(allowance) > MAX_REPEATS:
                raise JobError(
                    f"passes[{number}].depth is {cut.depth:g} mm, so the pass repeats {cut.repeats(allowance)} times, "
                    f"the limit is {MAX_REPEATS}: increase it"
                )
            names += cut.names(allowance)
            allowance = cut.allowance
            self._check_strategy(cut)
        _require_unique("passes", names)
        if self.strategy.along != "z" and self.strategy.moves_fast_tool:
            raise JobError(
                f'strategy.along must be "z" for the {self.strategy.kind}, got {self.strategy.along!r}: change it, or '
                "use a slow tool servo"
            )
        self._check_fast_tool()
        if allowance > 0:
            raise JobError(f"the allowance of the last pass must be 0 mm, got {allowance:g} mm: set it to 0 mm")
        _require_unique("simulation.patches", self.map_names)
        for number, patch in enumerate(self.simulation.patches, 1):
            self._check_patch(number, patch)
        _ = self.actual_tool, self.actual_machine
        if self.measurement.part:
            try:
                self.part.alone(self.measurement.part)
            except InputError as error:
                raise JobError(f"measurement.part: {error}") from error

    @property
    def map_names(self) -> list[str]:
        """Names of the maps to predict: the whole part, the parts of a chuck, and the patches."""
        surface = self.part.surface
        parts = surface.names if isinstance(surface, Chuck) else ()
        return ["whole part", *parts, *(patch.name for patch in self.simulation.patches)]

    def _check_patch(self, number: int, patch: Patch) -> None:
        """Raise unless a patch is on the part."""
        reach = max(math.hypot(x, y) for x in patch.axes[0][[0, -1]] for y in patch.axes[1][[0, -1]])
        if reach > self.part.reach:
            raise JobError(
                f"simulation.patches[{number}] extends {reach:.6g} mm from the axis, the limit is that of the part, "
                f"{self.part.reach:g} mm: move or shrink it"
            )
        if self.part.outline is None:
            return
        x, y = patch.samples
        off = self.part.outline.distance(x, y)
        if off.max() > BORDER_TOL:
            k = int(off.argmax())
            raise JobError(
                f"simulation.patches[{number}] includes x = {x.flat[k]:.6g} mm, y = {y.flat[k]:.6g} mm, "
                f"{off.flat[k]:.4g} mm outside the outline of the part: move or shrink it"
            )

    def _check_strategy(self, cut: PassTable) -> None:
        """Raise if a pass has no valid strategy, or machine or dialect cannot run it in spindle mode."""
        try:
            servo = self.servo(cut)
            chord, mode = getattr(servo.spiral_strategy, "chord", None), servo.spindle_mode
            if mode is not None:
                self.machine.in_spindle_mode()
            servo.require_crossings(self.part)
            require_spindle_modes(dialect_of(self.machine), [mode])
        except InputError as error:
            raise JobError(f"strategy of the pass {cut.name!r}: {error}") from error
        if cut.allowance and chord is not None and chord > cut.allowance:
            raise JobError(
                f"chord of the pass {cut.name!r} is {chord:g} mm, more than its allowance of {cut.allowance:g} mm, so "
                "that it may cut below the finished surface: reduce the chord"
            )

    def _check_servos(self) -> None:
        """Raise if tracking is simulated without servo data, or the program cannot be precorrected."""
        if self.program.precorrect and self.strategy.spindle_mode is not None:
            raise JobError(
                "program.precorrect is true, a cut in spindle mode has too few points for it: leave it out, or cut "
                "with C as an axis"
            )
        if self.simulation.tracking:
            from turnwright.job.contributions import require_servos  # noqa: PLC0415 - imports the simulation

            try:
                require_servos(self.actual_machine)
            except InputError as error:
                raise JobError(f"simulation.tracking: {error}") from error
        elif self.program.precorrect:
            raise JobError(
                "program.precorrect is true and simulation.tracking is false, so the prediction would show the "
                "corrections as errors: set both to true"
            )

    def _check_fast_tool(self) -> None:
        """Raise unless the table of a fast tool is stated exactly where the strategy moves one."""
        moves = self.strategy.moves_fast_tool
        by, rate = self.program.fast_tool, self.program.fast_tool_rate
        if moves != (by is not None) or (by == "time") != (rate is not None):
            raise JobError(
                f"program.fast_tool is {repr(by) if by else 'not stated'} and fast_tool_rate "
                f"{f'{rate:g} Hz' if rate else 'not stated'} with the {self.strategy.kind}: a fast tool needs "
                '"position", or "time" and a rate in Hz, any other strategy needs neither'
            )
        if moves and (len(self.passes) > 1 or self.passes[0].repeats(self.part.stock) > 1):
            raise JobError(
                "a job with a fast tool table must have 1 pass, this one has several: write one job for each pass"
            )

    def _check_dry_run(self) -> None:
        """Raise if a dry run is not above the stock, or is to be that of a fast tool."""
        height = self.program.dry_run
        if height is not None and height <= self.part.stock:
            raise JobError(
                f"program.dry_run is {height:g} mm, it must be above part.stock, {self.part.stock:g} mm: increase it"
            )
        if height is not None and self.strategy.moves_fast_tool:
            raise JobError("program.dry_run is stated, a fast tool has no dry run: leave it out")

    def _check_tools(self, dialect: Dialect) -> None:
        """Raise unless the tool of each pass is called where the passes use several."""
        program, changing = self.program, any(cut.tool is not None for cut in self.passes)
        called = {program.tool_call: (self.tool, "[program]")}
        if self.passes[-1].tool is not None:
            raise JobError("the last pass states a tool, it is cut with the tool of the job: state it as [tool]")
        if changing and program.change_height is None:
            raise JobError(
                "a pass states a tool, but program.change_height is missing: state the height above the part at which "
                "the tool is changed, enough for the longest tool"
            )
        for number, cut in enumerate(self.passes, 1):
            if (cut.tool is None) != (not cut.tool_call) or (changing and not program.tool_call):
                raise JobError(
                    f"passes[{number}] states {'a' if cut.tool else 'no'} tool and "
                    f"{repr(cut.tool_call) if cut.tool_call else 'no'} tool_call: a pass with a tool of its own needs "
                    "a tool_call, and so does [program] for the tool of the job"
                )
            tool, place = called.setdefault(cut.tool_call, (self.tool_of(cut), f"passes[{number}]"))
            if cut.tool is not None and cut.tool != tool:
                raise JobError(
                    f"passes[{number}].tool_call is {cut.tool_call!r}, as that of another tool in {place}: each tool "
                    "needs its own offset, correct one of them"
                )
            try:
                ProgramStart(tool_call=cut.tool_call).lines(dialect)
            except InputError as error:
                raise JobError(f"passes[{number}]: {error}") from error

    def tool_of(self, cut: PassTable) -> Tool:
        """Return the tool of a pass."""
        return cut.tool or self.tool

    def for_pass(self, cut: PassTable) -> Job:
        """Return the job with the tool of a pass; this job if the pass has none of its own."""
        if cut.tool is None:
            return self
        return replace(self, tool=cut.tool, actual=replace(self.actual, tool=ToolDeviations()))

    @property
    def cuts(self) -> dict[str, PassTable]:
        """The pass of every cut, by the name of the cut, in the order of cutting."""
        cuts: dict[str, PassTable] = {}
        stock = self.part.stock
        for one in self.passes:
            cuts |= dict.fromkeys(one.names(stock), one)
            stock = one.allowance
        return cuts

    def alone(self) -> Job:
        """Return the job of the part of a chuck that the map shows, at its place there; this job without a chuck.

        Raises
        ------
        JobError
            If the job does not state which part of the chuck the map shows.
        """
        chuck, stated = self.part.surface, self.measurement
        if not isinstance(chuck, Chuck):
            return self
        if not stated.part:
            raise JobError(
                f"the map shows one part of the chuck: state measurement.part, one of {', '.join(chuck.names)}"
            )
        mounted, part = chuck.mounted(stated.part), self.part.alone(stated.part)
        pose = mounted.pose.after(stated.pose or Pose())
        patches = tuple(one for one in self.simulation.patches if part.covers(*one.samples).all())
        return replace(
            self, part=part, simulation=replace(self.simulation, patches=patches),
            measurement=replace(stated, part="", shift=pose.shift, rotation=pose.rotation),
        )  # fmt: skip

    def with_alone(self, other: Job) -> Job:
        """Return this job with tool, machine and correction of the job of one part of its chuck, see `alone`."""
        chuck, stated = self.part.surface, self.measurement
        if not isinstance(chuck, Chuck):
            return other
        parts = tuple(
            replace(one, correction=other.part.correction) if one.name == stated.part else one for one in chuck.parts
        )
        measurement = replace(stated, corrected=other.measurement.corrected, cut_by=other.measurement.cut_by)
        part = replace(self.part, surface=replace(chuck, parts=parts))
        return replace(
            self, part=part, tool=other.tool, machine=other.machine, actual=other.actual, measurement=measurement
        )

    def servo(self, cut: PassTable) -> Strategy:
        """Return the strategy of one pass, with the values that the pass replaces."""
        if cut.kind is not None and self.strategy.kind != cut.kind:
            return self._rough_turning(cut)
        servo = self.strategy.with_fields(**cut.choices).adapted_to(self.tool_of(cut), self.machine)
        if servo.spindle_speeds is not None:
            require_variable(self.machine)
        return servo

    def _rough_turning(self, cut: PassTable) -> Turning:
        """Return the strategy of a roughing pass in spindle mode."""
        plan = self.strategy.spiral_strategy
        choices: dict[str, Any] = {"feed": getattr(plan, "feed", None), **cut.choices}
        if foreign := sorted(choices.keys() - types_of(Turning).keys()):
            raise InputError(f"{', '.join(foreign)} is set, which a pass in spindle mode does not have: remove it")
        if missing := [key for key in ("feed", "spindle_rpm", "chord") if choices.get(key) is None]:
            keys = ", ".join(missing).replace("spindle_rpm", "spindle_speed")
            raise InputError(f"it is turned in spindle mode and has no {keys}: state it in the pass")
        if not cut.allowance:
            raise InputError('it leaves no allowance, only roughing passes can be "turning": state it as strategy.kind')
        shared = {name: getattr(self.strategy, name) for name in ("sense", "inside_out", "along")}
        return Turning(**shared, **choices, symmetric_part=True)

    @property
    def light(self) -> OpticsTable:
        """How light meets the surface.

        Raises
        ------
        InputError
            If the job does not state it.
        """
        if self.optics is None:
            raise InputError("the job states no [optics], its optical performance needs a wavelength: add the table")
        return self.optics

    @property
    def reference(self) -> Surface:
        """The surface from which a map of departures is measured."""
        stated = self.measurement.departure_from
        return stated if isinstance(stated, Surface) else self.part.surface

    @property
    def actual_tool(self) -> Tool:
        """The tool for the simulation: nominal plus deviations."""
        return replace(self.tool, **self.actual.tool.stated)

    @property
    def actual_machine(self) -> Machine:
        """The machine for the simulation: nominal plus deviations."""
        return self.actual.machine.deviating(self.machine)

    @classmethod
    def read(cls, data: object, *, folder: str | PathLike[str] = ".") -> Job:
        """Return the job that a mapping describes, with quantities as text.

        Parameters
        ----------
        data
            Contents of a TOML file.
        folder
            Folder of the files that it names.
        """
        try:
            job: Job = adapter(cls).validate_python(data, context=context_of(folder))
        except ValidationError as error:
            raise JobError("\n".join(sentences(error, cls, {**FAMILIES, **STRATEGIES}))) from error
        return job

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Job:
        """Read a job file.

        Raises
        ------
        JobError
            If the file cannot be read, is not TOML, or is not a valid job; one line for each invalid field.
        """
        path = File(path)
        try:
            table = read_toml(bytes_of(path, "the job file"), f"the job file {str(path)!r}")
        except InputError as error:
            raise JobError(str(error)) from error
        return cls.read(table, folder=path.parent)

    def replace(self, name: str, value: Any) -> Job:
        """Return the job with one field changed; the new job is checked again.

        Parameters
        ----------
        name
            Name of the field as in the job file, such as ``strategy.feed``, ``passes.finish.feed`` or
            ``simulation.patches[1].pixel``; entries of a list by their name, or counted from 1.
        value
            Value of the field, lengths in mm and angles in rad, or text as in the job file.

        Raises
        ------
        JobError
            If there is no such field, or the job is invalid with this value.
        """
        return replace_field(self, name, value)

    def table(self, *, whole: bool = False) -> dict[str, Any]:
        """Return the job as the table of a TOML file: only values other than the defaults, or all of them."""
        return write_table(self, whole=whole)

    def to_toml(self) -> str:
        """Return the job as TOML text that `load` reads back to an equal job; names of files become absolute paths."""
        return tomli_w.dumps(self.table())

    def dump(self, path: str | PathLike[str]) -> None:
        """Write the job to a file in one step, so that no incomplete file is ever seen. See `to_toml`."""
        write_atomic(File(path), self.to_toml())


def faults(error: ValidationError) -> list[tuple[str, str]]:
    """Return the field and the message of each error in a job; a field is named like ``passes[1].feed``.

    Parameters
    ----------
    error
        The error of pydantic, as reading a `Job` raises it.
    """
    return list(dict.fromkeys(faults_of(error, Job, {**FAMILIES, **STRATEGIES})))
