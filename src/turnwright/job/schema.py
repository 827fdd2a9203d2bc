"""The job file: data only. What each table means stands with the class that it builds."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path as File
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, cast

import numpy as np
import tomli_w
from annotated_types import Ge, Le
from pydantic import Field, PlainValidator, Strict, ValidationError

from turnwright._faults import faults as faults_of, sentences
from turnwright._io import bytes_of, read_toml, write_whole
from turnwright._tables import adapter, read_by, types_of, written
from turnwright._validate import check_numbers
from turnwright.diagnosis import CAUSES
from turnwright.errors import InputError, JobError
from turnwright.job.named import AnyInstrument, AnyMachine, ExistingFile, MachineDeviations, context_of
from turnwright.job.table import Table
from turnwright.machine import Machine
from turnwright.motion import require_variable
from turnwright.part import Part
from turnwright.pose import Pose
from turnwright.post import FASTEST_PLUNGE, PLUNGE_FEED, dialect_of
from turnwright.speed_profile import Speeds
from turnwright.strategy import STRATEGIES, Strategy
from turnwright.surface import FAMILIES, Surface
from turnwright.tool import Tool, Waviness, WavinessTable
from turnwright.units import Angle, Count, Feed, Flag, Length, Size, Speed, Step, Text, Thickness, unit

if TYPE_CHECKING:
    from os import PathLike

    from turnwright._arrays import Floats

__all__ = ["Job", "PassTable", "faults"]

Name: TypeAlias = Annotated[str, Strict(), Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _-]{0,29}$")]
"""What a controller takes as the name of a sub-program, and any computer as that of a file."""

Accepted: TypeAlias = Literal["nose radius", "included angle", "clearance", "rake", "valley", "step", "limits", "gouge"]

MOST_REPEATS = 100
"""Times that one pass is repeated: beyond this a depth is a slip of the unit."""

MOST_VALUES = 100_000
"""In all tables and lists of a job: heights and curves have files of their own."""

MOST_SAMPLES = 1e8
"""Heights in one map: beyond this a pixel is a slip of the unit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolDeviations(Table):
    """What the actual tool has otherwise than the one planned with.

    Parameters
    ----------
    waviness
        Radial deviation of the edge, positive outward: coefficients of the sweep on the nose, of its square and
        so on, such as "0.2 um/rad", "-1 um/rad^2".
    waviness_file
        File with the columns sweep and deviation, each with its unit in the head, in place of the coefficients.
    radius_error
        Actual minus nominal nose radius. [mm]
    offset
        Where the tip really is minus where it should be: along X, in height, along Z. [mm]
    rake
        Angle of the rake face against the vertical, positive leaning back from the cutting direction. [rad]
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
            raise JobError("waviness and waviness_file are both given, only one can be right: remove one")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PassTable(Table):
    """One pass: what it states otherwise than the strategy, and how much it leaves and takes off.

    Parameters
    ----------
    name
        What the pass is called, in the program and in all results.
    feed
        Advance of X per revolution of the spindle, in this pass. [mm/rev]
    spindle_rpm
        Spindle speed in this pass; that of the strategy if left out. [rpm]
    spindle_speeds
        Speeds, each with the radius at which it is reached, in this pass.
    points_per_rev
        Program points in a revolution, in this pass.
    arc_length
        Distance between program points along the spiral, in this pass. [mm]
    max_step
        Largest angle between program points, in this pass. [rad]
    chord
        Largest height between the exact path and straight lines between the points, in this pass. [mm]
    lead_in
        How far beyond the clear radius the tip starts, in this pass. [mm]
    scallop
        Largest height of cusps, in this pass. [mm]
    allowance
        Material that is left above the finished surface when the pass is done; the last pass leaves none. [mm]
    depth
        Thickness taken off at a time: the pass is repeated, each time deeper, until its allowance is reached;
        all at once if left out. [mm]
    """

    key_names = MappingProxyType({"spindle_rpm": "spindle_speed"})
    name: Name
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

    @property
    def choices(self) -> dict[str, Any]:
        """What the pass states otherwise than the strategy."""
        own = (name for name in types_of(PassTable) if name not in ("name", "allowance", "depth"))
        return {name: value for name in own if (value := getattr(self, name)) is not None}

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.spindle_rpm is not None and self.spindle_speeds is not None:
            raise JobError("spindle_speed and spindle_speeds are both given, only one can be right: remove one")

    def repeats(self, stock: float) -> int:
        """Return how often the pass is cut, each time deeper, to take ``stock`` [mm] down to its allowance."""
        return max(1, math.ceil((stock - self.allowance) / self.depth - 1e-9)) if self.depth else 1

    def names(self, stock: float) -> list[str]:
        """Return the name of each repetition."""
        times = self.repeats(stock)
        return [self.name] if times == 1 else [f"{self.name} {number}" for number in range(1, times + 1)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Patch(Table):
    """A rectangle on the part to be predicted.

    Parameters
    ----------
    name
        What the place is called.
    centre
        Its middle on the part. [mm]
    size
        Along x and y. [mm]
    pixel
        Distance between heights; a quarter of the feed or less shows the cusps. [mm]
    """

    name: Name
    centre: tuple[Length, Length]
    size: tuple[Size, Size]
    pixel: Size

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """Columns and rows of the grid, centred, the pixel exact. [mm]."""
        axes = []
        for middle, size in zip(self.centre, self.size, strict=True):
            count = math.floor(size / self.pixel + 1e-9) + 1
            if count < 2:
                raise JobError(
                    f"pixel is {self.pixel:g} mm on a size of {size:g} mm, it must fit at least once: reduce it"
                )
            axes.append(np.asarray(middle + (np.arange(count) - (count - 1) / 2) * self.pixel, dtype=np.float64))
        return axes[0], axes[1]

    def __post_init__(self) -> None:
        check_numbers(self)
        points = math.prod(size / self.pixel + 1 for size in self.size)
        if points > MOST_SAMPLES:
            raise JobError(
                f"{self.name!r} has {points:.3g} points, the limit is {MOST_SAMPLES:.0e}: take a larger pixel"
            )
        _ = self.axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WholePart(Table):
    """The polar grid over the whole part.

    Parameters
    ----------
    radii
        Rings from the axis to the clear radius.
    angles
        Heights around each ring.
    """

    radii: Annotated[int, Strict(), Ge(2)] = 400
    angles: Annotated[int, Strict(), Ge(3)] = 360

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.radii * self.angles > MOST_SAMPLES:
            raise JobError(
                f"radii times angles is {self.radii * self.angles}, the limit is {MOST_SAMPLES:.0e}: take fewer"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationTable(Table):
    """What to predict, and whether the axes move as the machine's servos let them.

    Parameters
    ----------
    tracking
        Whether the axes move as the machine's servos let them; otherwise they go where they are sent.
    whole_part
        The polar map of the whole part.
    patches
        Small places at a fine pixel, of which the roughness is told.
    """

    tracking: Flag = False
    whole_part: WholePart = WholePart()
    patches: tuple[Patch, ...] = ()


def _form(value: object) -> int | str:
    known = ("none", "mean", "plane", "sphere")
    if value in known or (isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 10):
        return value
    raise JobError(
        f"{value!r} is neither one of {', '.join(known)} nor the degree of a polynomial, 0 to 10: give one of them"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoughnessTable(Table):
    """What is removed before the roughness of a patch is computed: see `turnwright.roughness`.

    Parameters
    ----------
    form
        "none", "mean", "plane", "sphere", or the degree of a polynomial, 0 to 10.
    """

    form: Annotated[int | str, PlainValidator(_form)] = "plane"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasurementTable(Table):
    """What is known of the instrument that measures the part, and what its map may be off by: see `turnwright.measure`.

    A map that the instrument shows from the other side is ``mirrored`` left to right, one whose heights grow into the
    material is ``inverted``.

    Parameters
    ----------
    pixel_size
        Distance between the instrument's pixels, for a file that does not say it: one size, or one along x and
        one along y. [mm]
    units
        Of x and y of a text file that states none.
    sag_units
        Of the heights of such a file.
    quantity
        What the map holds: heights, or departures from a reference along z or along its normal.
    departure_from
        What departures count from: "design", or any prescription.
    mirrored
        Whether the map shows the part from the other side, left for right.
    inverted
        Whether its heights grow into the material.
    spikes
        How single wrong heights are told from the part and taken out.
    trim
        Width of the edge of the map that is left out. [mm]
    shift
        Roughly where the middle of the map lies on the part, along x, y and z. [mm]
    rotation
        Roughly how the map is turned on the part. [rad]
    reach
        How far the map may lie from where it is said to lie. [mm]
    clocking
        How far it may be turned from there. [rad]
    free
        Which of its place and angles are found; the others stay as they are stated.
    terms
        Forms whose amplitude is found along with the pose, each a prescription; see `turnwright.register`.
    form_error
        Height at the rim by which low forms may be off, for what they do to the pose. [mm]
    weak
        What becomes of directions that such a form may pass for: "fit", "hold" where the map is said to lie, "raise".
    mask
        File with a map of the same grid: heights that are missing there, or 0 in a mask of 0 and 1, do not count.
    instrument
        Through which design and predicted cusps are seen before the map is compared with them: the name of a known
        one, a ``.toml`` file, or a table of its values. What is left out does nothing.
    loss
        How residuals count: "linear", "huber" or "tukey"; robust until spikes are out, then linear, if left out.
    noise
        Standard deviation of a height; found from the map if left out. [mm]
    reference
        What the form error is told against.
    causes
        Which causes are looked for; all that a single map can tell if left out.
    fixed
        What fiducials fix, so that it counts as an error of the part.
    waviness
        Powers of the sweep that the waviness of the edge is found in.
    worth
        Least rms by which a correction must make the form better for certain, and least effect of a cause. [mm]
    cutoff
        Shortest wavelength to which the part itself is corrected; found from part and feed if left out. [mm]
    correct
        Which causes tool and machine are corrected for if they are certain, all if left out; the rest is compensated as
        form of the part.
    repeats
        Whether drift, and form without a cause, that a single map shows are taken to come back on the next part.
    corrected
        Maps that this job was corrected by, as `correct` notes them, so that none is taken into account twice.
    cut_by
        "this job", if a part was cut by it as corrected though it shows what was corrected: the error came back.
    """

    pixel_size: Size | tuple[Size, Size] | None = None
    units: Literal["m", "mm", "um", "in"] | None = None
    sag_units: Literal["m", "mm", "um", "nm", "in"] | None = None
    quantity: Literal["height", "departure", "departure, along the normal"] = "height"
    departure_from: Literal["design"] | Surface | None = None
    mirrored: Flag = False
    inverted: Flag = False
    spikes: Literal["robust", "second difference", "none"] = "robust"
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
    weak: Literal["fit", "hold", "raise"] = "fit"
    mask: ExistingFile | None = None
    instrument: AnyInstrument | None = None
    loss: Literal["linear", "huber", "tukey"] | None = None
    noise: Size | None = None
    reference: Literal["true form", "best-fit sphere", "best-fit sphere, along its normal"] = "true form"
    causes: tuple[Text, ...] | None = None
    fixed: tuple[Literal["piston", "tilt", "decentre", "clocking"], ...] = ()
    waviness: tuple[Annotated[int, Strict(), Ge(1), Le(9)], ...] = (3, 4, 5, 6)
    worth: Thickness = 1e-6
    cutoff: Size | None = None
    correct: tuple[Text, ...] | None = None
    repeats: Flag = True
    corrected: tuple[Text, ...] = ()
    cut_by: Literal["this job"] | None = None

    @property
    def pose(self) -> Pose | None:
        """Roughly where the map lies on the part."""
        if self.shift is None and self.rotation is None:
            return None
        return Pose(shift=self.shift or (0.0, 0.0, 0.0), rotation=self.rotation or 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        for key in ("causes", "correct"):
            for cause in getattr(self, key) or ():
                if cause not in CAUSES:
                    raise JobError(f"{key} has {cause!r}, it can have {', '.join(CAUSES)}: name one of them")
        if (self.quantity == "height") != (self.departure_from is None):
            raise JobError(
                f"quantity is {self.quantity!r} and departure_from is "
                f"{'missing' if self.departure_from is None else 'stated'}: a departure needs what it counts from, "
                '"design" or a prescription, and a height counts from nothing'
            )
        for key in ("free", "causes", "waviness"):
            if (given := getattr(self, key)) is not None and not given:
                raise JobError(f"{key} is empty, it needs at least 1 entry: name one, or leave it out")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tolerances(Table):
    """What the part must keep; what it does not keep becomes a warning.

    Parameters
    ----------
    form_pv
        Peak to valley of the error over the whole part. [mm]
    sq
        Root mean square roughness of each patch. [mm]
    """

    form_pv: Size | None = None
    sq: Size | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actual(Table):
    """What to simulate with where it differs from what is planned with.

    Parameters
    ----------
    tool
        What the real tool has otherwise than the one planned with.
    machine
        What the real machine has otherwise than the one planned with.
    """

    tool: ToolDeviations = ToolDeviations()
    machine: MachineDeviations = MachineDeviations()  # noqa: RUF009 - frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramTable(Table):
    """How the program is written.

    Parameters
    ----------
    name
        Of the files of the program, without their ending.
    max_lines
        Most lines in one file; the limit of the controller if left out.
    fast_tool
        How the table of a fast tool is read: by position of the spindle, or by time.
    fast_tool_rate
        Heights per second of a table by time. [Hz]
    precorrect
        Whether the program is corrected beforehand for what the servos will make of it.
    plunge_feed
        Fastest plunge into the material where a pass cannot begin beside it; C turns meanwhile. [mm/s]
    """

    name: Annotated[str, Strict(), Field(pattern=r"^[A-Za-z0-9_-]{1,30}$")] = "part"
    max_lines: Annotated[int, Strict(), Ge(100)] | None = None
    fast_tool: Literal["position", "time"] | None = None
    fast_tool_rate: Annotated[float, unit("Hz", above=0.0)] | None = None
    precorrect: Flag = False
    plunge_feed: Annotated[float, unit("mm/s", above=0.0)] = PLUNGE_FEED

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.plunge_feed > FASTEST_PLUNGE:
            raise JobError(
                f"plunge_feed is {self.plunge_feed * 60:g} mm/min, the limit is {FASTEST_PLUNGE * 60:g} mm/min: check "
                "its unit"
            )


def _all_different(what: str, names: list[str]) -> None:
    """Raise if two names would share a file."""
    alike = [re.sub("[ -]+", "-", name).casefold() for name in names]
    for name, plain in zip(names, alike, strict=True):
        if alike.count(plain) > 1:
            raise JobError(
                f"{what} has the name {name!r} {alike.count(plain)} times as a file name, the limit is 1: rename one"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job(Table):
    """A job: everything that a run needs, as data. A wrong one cannot exist.

    Parameters
    ----------
    part, tool, machine, strategy
        What is to be cut, with what, on what and how.
    passes
        In the order of cutting, the last one leaves no allowance; one pass called "finish" if not given.
    simulation, actual
        What to predict, and what the tool and the machine have otherwise than planned.
    roughness, tolerances
        What is removed before roughness is computed, and what the part must keep.
    measurement
        What is known of the instrument that measures the part.
    program
        How the program is written.
    accept
        Findings that the shop accepts: those of `check_access` by name, "limits" of the machine, "gouge" of a path
        along the normal or of the predicted surface. Without it they end the run, with it they are warnings.

    Raises
    ------
    JobError
        One sentence a line for each field that is wrong.

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
    program: ProgramTable = ProgramTable()
    accept: tuple[Accepted, ...] = ()

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Refuse what is too long to be a job, before each of its values is judged."""
        count, waiting = 0, [cast("object", table)]
        while waiting:
            one = waiting.pop()
            if isinstance(one, dict | list | tuple):
                count += len(one)
                if count > MOST_VALUES:
                    raise JobError(
                        f"the job has more than {MOST_VALUES:,} values, the limit: keep long tables of numbers in "
                        "files of their own, which it names"
                    )
                waiting.extend(one.values() if isinstance(one, dict) else one)
        return table

    def __post_init__(self) -> None:
        check_numbers(self)
        try:
            dialect_of(self.machine)
        except InputError as error:
            raise JobError(f"machine: {error}") from error
        self._check_passes()
        self._check_servos()

    def _check_passes(self) -> None:
        """Raise unless the passes follow each other, and all that the job names is on the part."""
        if not self.passes:
            raise JobError("passes is empty, it needs at least 1: add one, or leave it out for a finishing pass alone")
        allowance, names = self.part.stock, []
        for number, cut in enumerate(self.passes, 1):
            if cut.allowance > allowance:
                raise JobError(
                    f"passes[{number}].allowance is {cut.allowance:g} mm, the limit is what is left before it, "
                    f"{allowance:g} mm: reduce it, or state the stock of the part"
                )
            if cut.repeats(allowance) > MOST_REPEATS:
                raise JobError(
                    f"passes[{number}].depth is {cut.depth:g} mm, so the pass repeats {cut.repeats(allowance)} times, "
                    f"the limit is {MOST_REPEATS}: increase it"
                )
            names += cut.names(allowance)
            allowance = cut.allowance
            try:
                self.servo(cut)
            except InputError as error:
                raise JobError(f"strategy of the pass {cut.name!r}: {error}") from error
        _all_different("passes", names)
        if self.strategy.along != "z" and self.strategy.moves_fast_tool:
            raise JobError(
                f'strategy.along is {self.strategy.along!r}, the {self.strategy.kind} plans for "z": choose that, or a '
                "slow tool servo"
            )
        self._check_fast_tool()
        if allowance > 0:
            raise JobError(f"the last pass leaves {allowance:g} mm, the limit is 0 mm: let it finish the part")
        _all_different("simulation.patches", ["whole part", *(patch.name for patch in self.simulation.patches)])
        for number, patch in enumerate(self.simulation.patches, 1):
            reach = max(math.hypot(x, y) for x in patch.axes[0][[0, -1]] for y in patch.axes[1][[0, -1]])
            if reach > self.part.radius:
                raise JobError(
                    f"simulation.patches[{number}] reaches {reach:.6g} mm from the axis, the limit is the clear radius "
                    f"{self.part.radius:g} mm: move or shrink it"
                )
        _ = self.actual_tool, self.actual_machine

    def _check_servos(self) -> None:
        """Raise unless it is known how the axes follow, where that counts."""
        if self.simulation.tracking:
            from turnwright.job.contributions import require_servos  # noqa: PLC0415 - the stages, which data does not need

            try:
                require_servos(self.actual_machine)
            except InputError as error:
                raise JobError(f"simulation.tracking: {error}") from error
        elif self.program.precorrect:
            raise JobError(
                "program.precorrect is true and simulation.tracking is false, so the prediction would take the "
                "corrections for errors: set both"
            )

    def _check_fast_tool(self) -> None:
        """Raise unless the job says how the table of a fast tool is written, if it has one."""
        moves = self.strategy.moves_fast_tool
        by, rate = self.program.fast_tool, self.program.fast_tool_rate
        if moves != (by is not None) or (by == "time") != (rate is not None):
            raise JobError(
                f"program.fast_tool is {repr(by) if by else 'not stated'} and fast_tool_rate "
                f"{f'{rate:g} Hz' if rate else 'not stated'} with the {self.strategy.kind}: a fast tool takes its "
                'heights by "position", or by "time" with a rate in Hz, and no other strategy has any'
            )
        if moves and (len(self.passes) > 1 or self.passes[0].repeats(self.part.stock) > 1):
            raise JobError(
                "the job has several passes, the table of a fast tool belongs to 1: write a job for each of them"
            )

    def servo(self, cut: PassTable) -> Strategy:
        """Return the strategy of one pass: what the pass states, else what all passes share."""
        servo = self.strategy.stating(**cut.choices).on(self.tool, self.machine)
        if servo.spindle_speeds is not None:
            require_variable(self.machine)
        return servo

    @property
    def actual_tool(self) -> Tool:
        """The tool to simulate with."""
        return replace(self.tool, **self.actual.tool.stated)

    @property
    def actual_machine(self) -> Machine:
        """The machine to simulate with."""
        return self.actual.machine.deviating(self.machine)

    @classmethod
    def read(cls, data: object, *, folder: str | PathLike[str] = ".") -> Job:
        """Return the job that a mapping describes, with quantities as text.

        Parameters
        ----------
        data
            As a TOML file reads.
        folder
            Where the files that it names are looked for.
        """
        try:
            found: Job = adapter(cls).validate_python(data, context=context_of(folder))
        except ValidationError as error:
            raise JobError("\n".join(sentences(error, cls, {**FAMILIES, **STRATEGIES}))) from error
        return found

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Job:
        """Read a job file.

        Raises
        ------
        JobError
            If the file cannot be read, is not TOML, or describes no job; one sentence a line for each wrong field.
        """
        path = File(path)
        try:
            table = read_toml(bytes_of(path, "the job file"), f"the job file {str(path)!r}")
        except InputError as error:
            raise JobError(str(error)) from error
        return cls.read(table, folder=path.parent)

    def replace(self, name: str, value: Any) -> Job:
        """Return the job with one field changed, all its checks made anew.

        Parameters
        ----------
        name
            Of the field as the job file writes it, such as ``strategy.feed``, ``passes.finish.feed`` or
            ``simulation.patches[1].pixel``; entries of a list by their name, or counted from 1.
        value
            As the field holds it, lengths in mm and angles in rad, or as the job file states it.

        Raises
        ------
        JobError
            If there is no such field, or the job cannot be with this value.
        """
        from turnwright.job.replacing import replaced  # noqa: PLC0415 - which reads the classes of this file

        return replaced(self, name, value)

    def table(self, *, whole: bool = False) -> dict[str, Any]:
        """Return the job as a TOML file states it: what is not as by default, or the whole of it."""
        return written(self, whole=whole)

    def to_toml(self) -> str:
        """Return the job as a file that `load` reads back to an equal job; files it names get their whole path."""
        return tomli_w.dumps(self.table())

    def dump(self, path: str | PathLike[str]) -> None:
        """Write the job as a file, which appears when it is whole. See `to_toml`."""
        write_whole(File(path), self.to_toml())


def faults(error: ValidationError) -> list[tuple[str, str]]:
    """Return the place of each thing that is wrong with a job, such as ``passes[1].feed``, and its sentence.

    Parameters
    ----------
    error
        What pydantic found, as reading a `Job` raises it.
    """
    return list(dict.fromkeys(faults_of(error, Job, {**FAMILIES, **STRATEGIES})))
