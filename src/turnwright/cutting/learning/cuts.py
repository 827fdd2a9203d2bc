"""Averaged forces of cuts with their geometry: straight edges, round noses, end mills and fly-cutters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Complexes, Floats, Ints, freeze, frozen, same_length
from turnwright._validate import between, check_numbers, positive
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.signals import ForceRecord, find_runs, in_air
from turnwright.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Cuts", "InterruptedCuts", "NoseCuts", "interrupted_cuts", "measured_cuts", "turning_cuts"]

Passband = Callable[[Floats], Complexes]

TURNED = ("axial", "feed", "cutting")
"""Force components in turning."""

SPINDLE_SPEED_TOL = 0.01
"""Relative tolerance of a stated spindle speed."""

SPEED_HARMONICS = 8
"""Harmonics from which the spindle speed is estimated, with eight means per period of the highest."""

MILLED = ("x", "y", "z")
"""Force components of an interrupted cut."""


def freeze_cuts(cuts: Cuts | NoseCuts, names: Sequence[str], optional: Sequence[str], components: int) -> None:
    """Convert the fields of cuts to arrays, and check that stated uncertainties are positive."""
    freeze(cuts, names, optional, of=" of the cuts")
    if cuts.uncertainty is None:
        return
    stated = frozen(cuts.uncertainty, "uncertainty of the cuts", ndim=2)
    same_length([(names[0], getattr(cuts, names[0])), ("uncertainty", stated)])
    if stated.shape[1] != components or not (stated > 0).all():
        raise InputError(
            f"uncertainty of the cuts must be {components} positive numbers for each cut, one for each measured "
            f"component, got an array of shape {stated.shape}"
        )
    object.__setattr__(cuts, "uncertainty", stated)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cuts:
    """Mean forces and uncut chips: one row for each steady cut, or for each short interval of a record.

    Parameters
    ----------
    thickness
        Maximum uncut chip thickness; 0 in air. (n,) [mm]
    width
        Width of cut. (n,) [mm]
    cutting, thrust
        Mean forces. Each (n,) [N]
    area
        Uncut chip area across the cutting direction; by default thickness times width (orthogonal cutting). (n,) [mm²]
    thrust_area
        Area that the thrust coefficient multiplies: for a round nose the area projected along the measured direction.
        By default ``area``. (n,) [mm²]
    uncertainty
        Standard uncertainties of cutting force and thrust; ``None`` to estimate them from the scatter. (n, 2) [N]
    time
        Time of each row, if the rows are intervals of a record. (n,) [s]
    spread
        Half of the range of thicknesses within each row. (n,) [mm]
    record
        Index of the record of each row; each record has its own drift. By default there is one record. (n,)

    Raises
    ------
    InputError
        If the arrays differ in length, or a thickness or width is negative.
    """

    thickness: Floats
    width: Floats
    cutting: Floats
    thrust: Floats
    area: Floats | None = None
    thrust_area: Floats | None = None
    uncertainty: Floats | None = None
    time: Floats | None = None
    spread: Floats | None = None
    record: Floats | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        optional = ("area", "thrust_area", "time", "spread", "record")
        freeze_cuts(self, ("thickness", "width", "cutting", "thrust"), optional, 2)
        if self.thickness.size and min(self.thickness.min(), self.width.min()) < 0:
            raise InputError(
                f"thickness and width of the cuts must be at least 0 mm, got "
                f"{min(self.thickness.min(), self.width.min()):g} mm"
            )
        without_width = int(np.count_nonzero((self.thickness > 0) & (self.width == 0)))
        if without_width:
            raise InputError(f"width must be above 0 mm where the thickness is, got 0 mm for {without_width} cuts")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoseCuts:
    """Mean forces in turning with a round nose: one row for each steady cut, or for each short interval of a record.

    Parameters
    ----------
    nose_radius, depth
        Tool nose radius, and depth of cut. Each (n,) [mm]
    feed
        Feed; 0 in air. (n,) [mm/rev]
    axial, feed_force, cutting
        Mean forces on the tool: out of the part, against the feed and against the cutting direction; ``None`` for a
        component that was not measured. Each (n,) [N]
    uncertainty
        Standard uncertainties of the measured components, in this order; ``None`` to estimate them from the scatter.
        (n, components) [N]
    time
        Time of each row, if the rows are intervals of a record. (n,) [s]
    record
        Index of the record of each row; each record has its own drift. By default there is one record. (n,)

    Raises
    ------
    InputError
        If the arrays differ in length, no force component is stated, or a feed is negative.
    """

    nose_radius: Floats
    depth: Floats
    feed: Floats
    axial: Floats | None = None
    feed_force: Floats | None = None
    cutting: Floats | None = None
    uncertainty: Floats | None = None
    time: Floats | None = None
    record: Floats | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        if not self.components:
            raise InputError("the cuts must have at least 1 force component (axial, feed_force or cutting), got 0")
        optional = ("axial", "feed_force", "cutting", "time", "record")
        freeze_cuts(self, ("nose_radius", "depth", "feed"), optional, len(self.components))
        if self.feed.size and self.feed.min() < 0:
            raise InputError(f"feed of the cuts must be at least 0 mm/rev, got {self.feed.min():g} mm/rev")

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the measured components: axial, feed, cutting."""
        forces = (self.axial, self.feed_force, self.cutting)
        return tuple(name for name, force in zip(TURNED, forces, strict=True) if force is not None)

    @property
    def force(self) -> Floats:
        """Measured forces. (n, components) [N]."""
        return np.column_stack([force for force in (self.axial, self.feed_force, self.cutting) if force is not None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InterruptedCuts:
    """Mean forces in milling or fly-cutting over short intervals of one or more records.

    Parameters
    ----------
    geometry
        Cutter and cut of each record. (records)
    spindle_rpm
        Spindle speed of each record, within 1 %; it is refined from the forces. (records) [rev/min]
    components
        Names of the measured components x, y and z, see `ForceHistory`.
    force
        Mean forces, including the drift. (n, components) [N]
    begin, end
        Begin and end of each interval in its record. Each (n,) [s]
    cut
        Index of the pass of each interval, counted through all records; -1 in air. (n,)
    record
        Index of the record of each interval. (n,)
    rate_hz
        Sampling rate of the records. [Hz]
    whole_turns
        Whether each interval is a whole number of cutter revolutions.
    passband
        Transfer matrix of the filters that the forces have passed, over frequency: (k,) [Hz] to (k, components,
        components). ``None`` if unfiltered.
    """

    geometry: tuple[SlotMill | FlyCut, ...]
    spindle_rpm: tuple[float, ...]
    components: tuple[str, ...]
    force: Floats
    begin: Floats
    end: Floats
    cut: Ints
    record: Ints
    rate_hz: float
    whole_turns: bool = False
    passband: Passband | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "force", frozen(self.force, "the forces of the cuts", ndim=2))
        freeze(self, ("begin", "end"), of=" of the cuts")
        same_length([("force", self.force), ("begin", self.begin)])
        if (
            not self.components
            or not set(self.components) <= set(MILLED)
            or len(self.components) != self.force.shape[1]
        ):
            raise InputError(
                "components of the cuts must name each column of force x, y or z, got "
                f"{', '.join(self.components) or 'none'} for {self.force.shape[1]} columns"
            )


def measured_cuts(
    record: ForceRecord,
    cuts: ArrayLike,
    *,
    cutting: str,
    thrust: str,
    thickness: Callable[[Floats], Floats],
    width: float,
    block: float,
    guard: float,
) -> Cuts:
    """Average a record over short intervals, in the cuts and in air.

    Parameters
    ----------
    record
        Forces, corrected for the dynamometer response; drift may be included, see `learn_material`.
    cuts
        First sample of each cut and first one after it, see `engagements`. (m, 2)
    cutting, thrust
        Channel names, with a minus sign to reverse the direction.
    thickness
        Function for the uncut chip thickness over time. (k,) [s] to (k,) [mm]
    width
        Width of cut. [mm]
    block
        Length of an interval; it limits the resolution of the transition. [s]
    guard
        Time excluded on either side of each entry and exit. [s]

    Raises
    ------
    InputError
        If no interval fits in a cut.
    """
    at = divide_record(record, cuts, block=block, guard=guard)
    start, step, flag = at.start, at.step, at.cut >= 0
    begin, end = start / record.rate_hz, (start + step - 1) / record.rate_hz
    ends = np.array([np.where(flag, thickness(at), 0.0) for at in (begin, end)])
    return Cuts(
        thickness=ends.mean(axis=0),
        width=np.where(flag, width, 0.0),
        cutting=at.means(record.channel(cutting)),
        thrust=at.means(record.channel(thrust)),
        time=(begin + end) / 2,
        spread=np.abs(ends[1] - ends[0]) / 2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Short intervals of a record, in its cuts and in air, in the order of time."""

    start: Ints
    step: int
    cut: Ints  # index of the cut of each interval; -1 in air

    def means(self, values: Floats) -> Floats:
        """Return the mean of each interval."""
        total = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray((total[self.start + self.step] - total[self.start]) / self.step)


def divide_record(record: ForceRecord, cuts: ArrayLike, *, block: float, guard: float) -> Intervals:
    """Divide a record into intervals of equal length, each within one cut or in air."""
    step = max(1, round(positive(block, "block", "s") * record.rate_hz))
    margin = max(0, round(between(guard, "guard", 0.0, np.inf, "s") * record.rate_hz))
    pairs = np.asarray(cuts, dtype=np.int64).reshape(-1, 2)
    air = in_air(record.samples, pairs, guard=margin)
    spans = [(first + margin, last - margin, number) for number, (first, last) in enumerate(pairs)]
    spans += [(first, last, -1) for first, last in find_runs(air)]
    starts, which = [], []
    for first, last, number in spans:
        count = max((last - first) // step, 0)
        starts.append(first + step * np.arange(count))
        which.append(np.full(count, number))
    start, cut = np.concatenate(starts).astype(np.int64), np.concatenate(which).astype(np.int64)
    if not (cut >= 0).any():
        raise InputError(
            f"no interval of {block:g} s fits in a cut with {guard:g} s excluded at entry and exit: reduce block or "
            "guard"
        )
    order = np.argsort(start)
    return Intervals(start[order], step, cut[order])


def turning_cuts(
    record: ForceRecord,
    cuts: ArrayLike,
    *,
    nose_radius: float,
    depth: ArrayLike,
    feed: ArrayLike,
    block: float,
    guard: float,
    axial: str | None = None,
    feed_force: str | None = None,
    cutting: str | None = None,
) -> NoseCuts:
    """Average a record of turning over short intervals, in the cuts and in air.

    Parameters
    ----------
    record
        Forces, corrected for the dynamometer response; drift may be included.
    cuts
        First sample of each cut and first one after it, see `engagements`. (m, 2)
    nose_radius
        Tool nose radius. [mm]
    depth, feed
        Depth of cut and feed of each cut, or one value for all. (m,) or () [mm, mm/rev]
    block
        Length of an interval. [s]
    guard
        Time excluded on either side of each entry and exit; at least the time until the chip is fully developed. [s]
    axial, feed_force, cutting
        Channel names, with a minus sign to reverse the direction; ``None`` for a component that was not measured.

    Raises
    ------
    InputError
        If no interval fits in a cut.
    """
    at = divide_record(record, cuts, block=block, guard=guard)
    count = np.asarray(cuts).reshape(-1, 2).shape[0]

    def of_each(values: ArrayLike) -> Floats:
        return np.where(at.cut >= 0, np.broadcast_to(np.asarray(values, dtype=np.float64), count)[at.cut], 0.0)

    forces = {"axial": axial, "feed_force": feed_force, "cutting": cutting}
    return NoseCuts(
        nose_radius=np.full(at.cut.size, nose_radius),
        depth=of_each(depth),
        feed=of_each(feed),
        time=np.asarray((at.start + (at.step - 1) / 2) / record.rate_hz),
        **{key: at.means(record.channel(name)) for key, name in forces.items() if name is not None},
    )


def interrupted_cuts(
    record: ForceRecord,
    passes: ArrayLike,
    *,
    geometry: SlotMill | FlyCut,
    spindle_rpm: float,
    block: float | None,
    guard: float,
    x: str | None = None,
    y: str | None = None,
    z: str | None = None,
    passband: Passband | None = None,
) -> InterruptedCuts:
    """Average a record of milling or fly-cutting over intervals much shorter than a revolution, or whole revolutions.

    Parameters
    ----------
    record
        Forces, corrected for the dynamometer response; drift may be included.
    passes
        First sample of each pass and first one after it, see `engagements` with ``shortest`` of several revolutions.
        (m, 2)
    geometry
        Cutter and cut.
    spindle_rpm
        Spindle speed, within 1 %; it is refined from the forces. [rev/min]
    block
        Length of an interval; ``None`` for the number of revolutions (1 to 8) nearest to a whole number of samples. [s]
    guard
        Time excluded on either side of each pass: until the cutter is fully engaged. [s]
    x, y, z
        Channel names, see `ForceHistory`, with a minus sign to reverse the direction; ``None`` for a component that
        was not measured.
    passband
        Transfer matrix of the filters that the forces have passed, in the order of the record's channels: (k,) [Hz] to
        (k, channels, channels), such as `Dynamometer.resolution`. ``None`` if unfiltered.

    Raises
    ------
    InputError
        If no interval fits in a pass.
    """
    whole_turns = block is None
    positive(spindle_rpm, "spindle_rpm", "rev/min")
    if block is None:
        turn = _estimate_turn(record, passes, 60 / spindle_rpm)
        turns = np.arange(1, 9)
        off = np.abs(turn * turns * record.rate_hz - np.round(turn * turns * record.rate_hz)) / turns
        block = turn * float(turns[int(np.argmin(off))])
    at = divide_record(record, passes, block=block, guard=guard)
    named = [(name, channel) for name, channel in zip(MILLED, (x, y, z), strict=True) if channel is not None]
    if not named:
        raise InputError("the cuts must have at least 1 force component (x, y or z), got 0")
    columns = [at.means(record.channel(channel)) for _, channel in named]
    chosen = None
    if passband is not None:
        plain = [channel if channel in record.channels else channel[1:] for _, channel in named]
        index = [record.channels.index(channel) for channel in plain]
        sign = np.array([1.0 if channel in record.channels else -1.0 for _, channel in named])
        full = passband

        def chosen(frequency: Floats) -> Complexes:
            return np.asarray(full(frequency)[:, index][:, :, index] * np.outer(sign, sign))

    return InterruptedCuts(
        geometry=(geometry,),
        spindle_rpm=(float(spindle_rpm),),
        components=tuple(name for name, _ in named),
        force=np.column_stack(columns),
        begin=np.asarray((at.start - 0.5) / record.rate_hz),
        end=np.asarray((at.start + at.step - 0.5) / record.rate_hz),
        cut=at.cut,
        record=np.zeros(at.cut.size, dtype=np.int64),
        rate_hz=record.rate_hz,
        whole_turns=whole_turns,
        passband=chosen,
    )


def _estimate_turn(record: ForceRecord, passes: ArrayLike, stated: float) -> float:
    """Return the time of a revolution in the longest pass, from the power of the force in its harmonics. [s]."""
    pairs = np.asarray(passes, dtype=np.int64).reshape(-1, 2)
    first, last = pairs[int(np.argmax(pairs[:, 1] - pairs[:, 0]))]
    step = max(1, int(stated * record.rate_hz / (8 * SPEED_HARMONICS)))
    count = (last - first) // step
    if count * step < 2 * stated * record.rate_hz:
        raise InputError(
            "the longest pass must have at least 2 revolutions for means over whole revolutions, got "
            f"{count * step / (stated * record.rate_hz):.2g}: record for longer"
        )
    force = record.force[first : first + count * step].reshape(count, step, -1).mean(axis=1)
    force = force - force.mean(axis=0)
    time = step / record.rate_hz * (np.arange(count) - count / 2)
    order = np.arange(1, SPEED_HARMONICS + 1)
    many = int(np.ceil(SPINDLE_SPEED_TOL * count * step / record.rate_hz / stated * SPEED_HARMONICS * 16))
    return 2 * np.pi / find_speed(force, time, order, 2 * np.pi / stated, many)


def find_speed(force: Floats, time: Floats, order: Ints, nominal: float, count: int) -> float:
    """Return the speed near the nominal one at which the forces have the most power in harmonics. [rad/s]."""
    speeds = nominal * (1 + SPINDLE_SPEED_TOL * np.linspace(-1, 1, 2 * count + 1))
    power = [float((np.abs(np.exp(-1j * speed * np.outer(order, time)) @ force) ** 2).sum()) for speed in speeds]
    return float(speeds[int(np.argmax(power))])
