"""Forces of cuts and what was cut: straight edges, round noses, mills and fly-cutters; the averages of records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Complexes, Floats, Ints, freeze, frozen, same_length
from turnwright._validate import between, check_numbers, positive
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.signals import ForceRecord, in_air
from turnwright.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Cuts", "InterruptedCuts", "NoseCuts", "interrupted_cuts", "measured_cuts", "turning_cuts"]

Passband = Callable[[Floats], Complexes]

TURNED = ("axial", "feed", "cutting")
"""Components of the force in turning."""

OFF_SPEED = 0.01
"""Share by which the stated speed of a spindle may be off."""

HEARD = 8
"""Harmonics by which the speed of a spindle is told, from so many times eight means a turn."""

MILLED = ("x", "y", "z")
"""Components of the force of an interrupted cut."""


def freeze_cuts(cuts: Cuts | NoseCuts, names: Sequence[str], optional: Sequence[str], components: int) -> None:
    """Make arrays of the fields of cuts, with positive uncertainties of all components if they are stated."""
    freeze(cuts, names, optional, of=" of the cuts")
    if cuts.uncertainty is None:
        return
    stated = frozen(cuts.uncertainty, "uncertainty of the cuts", ndim=2)
    same_length([(names[0], getattr(cuts, names[0])), ("uncertainty", stated)])
    if stated.shape[1] != components or not (stated > 0).all():
        raise InputError(
            f"the uncertainties of the cuts are not {components} positive numbers for each: give one for each "
            "component that was measured, or none at all"
        )
    object.__setattr__(cuts, "uncertainty", stated)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cuts:
    """Forces and the chips that they belong to: a row for each steady cut, or for each short stretch of a record.

    Parameters
    ----------
    thickness
        Thickest place of the uncut chip; 0 where the tool is in air. (n,) [mm]
    width
        Of the uncut chip. (n,) [mm]
    cutting, thrust
        Mean forces. Each (n,) [N]
    area
        Of the uncut chip across the cutting direction; thickness times width, as in orthogonal cutting, if not given.
        (n,) [mm²]
    thrust_area
        What the thrust coefficient multiplies: for a round nose the area as it is seen along the measured direction.
        As ``area`` if not given. (n,) [mm²]
    uncertainty
        Standard uncertainties of cutting force and thrust; ``None`` where the scatter of the rows is to tell. (n, 2)
        [N]
    time
        Of each row, where the rows are stretches of one record. (n,) [s]
    spread
        Half the range of thicknesses within each row. (n,) [mm]
    record
        Number of the record that each row is of; each has a drift of its own. All are of one if not given. (n,)

    Raises
    ------
    InputError
        If the arrays differ in length, or a thickness or width is below zero.
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
                f"the cuts have a thickness or width of {min(self.thickness.min(), self.width.min()):g} mm, the "
                "limit is 0 mm: correct it"
            )
        bare = int(np.count_nonzero((self.thickness > 0) & (self.width == 0)))
        if bare:
            raise InputError(f"{bare} cuts have a thickness and a width of 0 mm: state how wide they are")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoseCuts:
    """Forces of turning with a round nose: a row for each steady cut, or for each short stretch of a record.

    Parameters
    ----------
    nose_radius, depth
        Of the tool, and of its tip below the stock. Each (n,) [mm]
    feed
        Advance per turn; 0 where the tool is in air. (n,) [mm/rev]
    axial, feed_force, cutting
        Mean forces on the tool out of the part, against the feed and against the cut; ``None`` for what was not
        measured. Each (n,) [N]
    uncertainty
        Standard uncertainties of those that were measured, in this order; ``None`` where the scatter of the rows is to
        tell. (n, components) [N]
    time
        Of each row, where the rows are stretches of one record. (n,) [s]
    record
        Number of the record that each row is of; each has a drift of its own. All are of one if not given. (n,)

    Raises
    ------
    InputError
        If the arrays differ in length, no force was measured, or a chip is none.
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
            raise InputError(
                "the cuts have 0 components of the force, at least 1 is needed: give axial, feed or cutting"
            )
        optional = ("axial", "feed_force", "cutting", "time", "record")
        freeze_cuts(self, ("nose_radius", "depth", "feed"), optional, len(self.components))
        if self.feed.size and self.feed.min() < 0:
            raise InputError(f"the cuts have a feed of {self.feed.min():g} mm/rev, the limit is 0 mm/rev: correct it")

    @property
    def components(self) -> tuple[str, ...]:
        """Which of axial, feed and cutting were measured."""
        given = (self.axial, self.feed_force, self.cutting)
        return tuple(name for name, one in zip(TURNED, given, strict=True) if one is not None)

    @property
    def force(self) -> Floats:
        """Forces that were measured. (n, components) [N]."""
        return np.column_stack([one for one in (self.axial, self.feed_force, self.cutting) if one is not None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InterruptedCuts:
    """Forces of milling or fly-cutting: means over short stretches of one or more records.

    Parameters
    ----------
    geometry
        What was cut in each record. (records)
    spindle_rpm
        In each, to a hundredth; the forces tell it better. (records) [rev/min]
    components
        Which of x, y and z were measured, see `ForceHistory`.
    force
        Means, the drift left in. (n, components) [N]
    begin, end
        Of each stretch in its record. Each (n,) [s]
    cut
        Number of the pass in which each is, counted through all records; -1 in air. (n,)
    record
        Number of the record that each is of. (n,)
    rate_hz
        Samples per second of the records. [Hz]
    whole_turns
        Whether each stretch is as long as the cutter turns, or a multiple of it.
    passband
        What the filters before this leave of a force at some frequencies, (k,) [Hz] to (k, components, components);
        ``None`` for all of it.
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
                f"the cuts have the components {', '.join(self.components) or 'none'} and {self.force.shape[1]} "
                "columns of forces: name each column x, y or z"
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
    """Average a record over short stretches, in the cuts and in air.

    Parameters
    ----------
    record
        Forces, the dynamometer's own share taken out; the drift may stay in, see `learn_material`.
    cuts
        First sample of each cut and first one after it, see `engagements`. (m, 2)
    cutting, thrust
        Which channel is which, with a minus where it points the other way.
    thickness
        Gives the chip thickness at some times. (k,) [s] to (k,) [mm]
    width
        Of the chip. [mm]
    block
        Length of a stretch; the transition is found to about this. [s]
    guard
        What is left out on either side of each entry and exit. [s]

    Raises
    ------
    InputError
        If no stretch fits in a cut.
    """
    at = stretches(record, cuts, block=block, guard=guard)
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
class Stretches:
    """Short stretches of a record, in its cuts and in air, in the order of time."""

    start: Ints
    step: int
    cut: Ints  # number of the cut that each is in; -1 in air

    def means(self, values: Floats) -> Floats:
        """Return the mean of each stretch."""
        total = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray((total[self.start + self.step] - total[self.start]) / self.step)


def stretches(record: ForceRecord, cuts: ArrayLike, *, block: float, guard: float) -> Stretches:
    """Divide a record into stretches of one length that lie in one cut, or in air."""
    step = max(1, round(positive(block, "block", "s") * record.rate_hz))
    margin = max(0, round(between(guard, "guard", 0.0, np.inf, "s") * record.rate_hz))
    pairs = np.asarray(cuts, dtype=np.int64).reshape(-1, 2)
    air = in_air(record.samples, pairs, guard=margin)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], air, [False])).astype(np.int8))).reshape(-1, 2)
    spans = [(first + margin, last - margin, number) for number, (first, last) in enumerate(pairs)]
    spans += [(first, last, -1) for first, last in edges]
    starts, which = [], []
    for first, last, number in spans:
        count = max((last - first) // step, 0)
        starts.append(first + step * np.arange(count))
        which.append(np.full(count, number))
    start, cut = np.concatenate(starts).astype(np.int64), np.concatenate(which).astype(np.int64)
    if not (cut >= 0).any():
        raise InputError(
            f"no stretch of {block:g} s fits in a cut with {guard:g} s left out at entry and exit: shorten them"
        )
    order = np.argsort(start)
    return Stretches(start[order], step, cut[order])


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
    """Average a record of turning over short stretches, in the cuts and in air.

    Parameters
    ----------
    record
        Forces, the dynamometer's own share taken out; the drift may stay in.
    cuts
        First sample of each cut and first one after it, see `engagements`. (m, 2)
    nose_radius
        Of the tool. [mm]
    depth, feed
        Of each cut, or one for all. (m,) or () [mm, mm/rev]
    block
        Length of a stretch. [s]
    guard
        What is left out on either side of each entry and exit; at least as long as the chip takes to grow. [s]
    axial, feed_force, cutting
        Which channel is which, with a minus where it points the other way; ``None`` where none is.

    Raises
    ------
    InputError
        If no stretch fits in a cut.
    """
    at = stretches(record, cuts, block=block, guard=guard)
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
    """Average a record of milling or fly-cutting over stretches much shorter than a turn, or over whole turns.

    Parameters
    ----------
    record
        Forces, the dynamometer's own share taken out; the drift may stay in.
    passes
        First sample of each pass and first one after it, see `engagements` with a ``shortest`` of some turns. (m, 2)
    geometry
        What is cut.
    spindle_rpm
        To a hundredth; the forces tell it better. [rev/min]
    block
        Length of a stretch; ``None`` to average over as many whole turns as come nearest to a number of samples. [s]
    guard
        What is left out on either side of each pass: as long as the cutter takes to be in the part as stated. [s]
    x, y, z
        Which channel is which, see `ForceHistory`, with a minus where it points the other way; ``None`` where none is.
    passband
        What filters have left of the forces, in the order of the record's channels: (k,) [Hz] to (k, channels,
        channels), such as `Dynamometer.resolution` gives. ``None`` for all of it.

    Raises
    ------
    InputError
        If no stretch fits in a pass.
    """
    whole = block is None
    positive(spindle_rpm, "spindle_rpm", "rev/min")
    if block is None:
        turn = _true_turn(record, passes, 60 / spindle_rpm)
        turns = np.arange(1, 9)
        off = np.abs(turn * turns * record.rate_hz - np.round(turn * turns * record.rate_hz)) / turns
        block = turn * float(turns[int(np.argmin(off))])
    at = stretches(record, passes, block=block, guard=guard)
    named = [(name, one) for name, one in zip(MILLED, (x, y, z), strict=True) if one is not None]
    if not named:
        raise InputError("the cuts have 0 components of the force, at least 1 is needed: give x, y or z")
    columns = [at.means(record.channel(one)) for _, one in named]
    chosen = None
    if passband is not None:
        plain = [one if one in record.channels else one[1:] for _, one in named]
        index = [record.channels.index(one) for one in plain]
        sign = np.array([1.0 if one in record.channels else -1.0 for _, one in named])
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
        whole_turns=whole,
        passband=chosen,
    )


def _true_turn(record: ForceRecord, passes: ArrayLike, stated: float) -> float:
    """Return the time of a turn in the longest pass: at it the force has most power in its harmonics. [s]."""
    pairs = np.asarray(passes, dtype=np.int64).reshape(-1, 2)
    first, last = pairs[int(np.argmax(pairs[:, 1] - pairs[:, 0]))]
    step = max(1, int(stated * record.rate_hz / (8 * HEARD)))
    count = (last - first) // step
    if count * step < 2 * stated * record.rate_hz:
        raise InputError(
            f"the longest pass has {count * step / (stated * record.rate_hz):.2g} turns, means over whole turns need "
            "at least 2: record for longer"
        )
    force = record.force[first : first + count * step].reshape(count, step, -1).mean(axis=1)
    force = force - force.mean(axis=0)
    time = step / record.rate_hz * (np.arange(count) - count / 2)
    order = np.arange(1, HEARD + 1)
    many = int(np.ceil(OFF_SPEED * count * step / record.rate_hz / stated * HEARD * 16))
    speeds = 2 * np.pi / stated * (1 + OFF_SPEED * np.linspace(-1, 1, 2 * many + 1))
    power = [float((np.abs(np.exp(-1j * one * np.outer(order, time)) @ force) ** 2).sum()) for one in speeds]
    return float(2 * np.pi / speeds[int(np.argmax(power))])
