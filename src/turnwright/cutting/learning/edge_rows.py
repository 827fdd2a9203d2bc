"""Regression for chips of varying thickness along the edge: design matrix, and fit of the critical thickness.

The edge is divided into elements, each with its minimum and maximum thickness, so that the part beyond a limit changes
smoothly with the limit. For a rotating cutter the columns are computed over its angle, filtered like the forces,
harmonic by harmonic, and averaged over the same time intervals. Model and intervals: docs/theory/learning_forces.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats
from turnwright.cutting.chip import RoundChip
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.cuts import MILLED, SPINDLE_SPEED_TOL, TURNED, InterruptedCuts, NoseCuts, find_speed
from turnwright.cutting.learning.regression import MAX_CHANCE, MIN_ROWS, TINY, Fit, Rows, hansen, interval
from turnwright.cutting.learning.results import FORCE_NAMES, Transition
from turnwright.errors import InputError

__all__ = ["InterruptedRows", "TurningRows"]

NOSE_ELEMENTS = 256
"""Elements on each smooth piece of a nose in a steady cut."""

ENGAGED_ANGLES = 512
"""Angles of a tooth while it cuts."""

TOOTH_ELEMENTS = 96
"""Elements along the nose of a fly-cutter, or around the corner of an end mill."""

MAX_HARMONICS = 4096
"""Harmonics of a revolution; averages over intervals remove higher ones."""

TABLE_ANGLES = 1 << 13
"""Angles of a revolution in the table of filtered forces."""

LABELS = {"axial": "axial force", "feed": "feed force", "cutting": "cutting force"}
"""Names of the force components in turning."""

TRIAL_THICKNESSES = 96
"""Trial thicknesses of a transition."""

BISECTIONS = 12
"""Bisections for each end of the interval."""


class _Strips:
    """Elements of an edge at several states of the cut (states, elements), with their contributions to the forces."""

    def __init__(
        self,
        thickness: tuple[Floats, Floats, Floats],
        area: Floats,
        along: Floats,
        normal: Floats,
        components: Sequence[int],
    ) -> None:
        self.least, self.middle, self.most = thickness
        self.area = area
        self.directions = (along[..., components], normal[..., components])
        self.thickest = self.most.max(axis=1)
        self.even = bool((np.where(area > 0, self.middle, np.inf).min(axis=1) >= 0.99 * self.middle.max(axis=1)).all())
        self.width = np.divide(area, self.middle, out=np.zeros_like(area), where=self.middle > 0)
        self.beyond = self._forces([[self.width, area]] * 2)
        self.cache: tuple[object, Floats] | None = None  # key and value of the last ductile forces

    def columns(self, limit: float, edge: bool, power: Sequence[float] | None, reference: float) -> Floats:
        """Return the design matrix, see `Rows.columns`. (states, components, parameters)."""
        ductile = self._ductile(edge, power, reference)
        if np.isfinite(limit):
            span = np.maximum(self.most - self.least, 1e-12 * limit)
            below = np.clip((limit - self.least) / span, 0.0, 1.0)
            sums = [_weighted_sum(below, ductile), _weighted_sum(1 - below, self.beyond)]
        else:
            sums = [ductile.sum(axis=1)]
        columns = np.concatenate(sums, axis=1).reshape(self.area.shape[0], -1, self.directions[0].shape[-1])
        return columns.transpose(0, 2, 1)

    def _ductile(self, edge: bool, power: Sequence[float] | None, reference: float) -> Floats:
        key = (edge, None if power is None else tuple(power), reference)
        if self.cache is None or self.cache[0] != key:
            if power is not None:
                ratio = np.where(self.middle > 0, self.middle, reference) / reference
                falling = [self.area * ratio**-exponent for exponent in power]
                parts = [[area, -area * np.log(ratio)] for area in falling]
            else:
                parts = [[self.area, self.width] if edge else [self.area]] * 2
            self.cache = key, self._forces(parts)
        return self.cache[1]

    def _forces(self, parts: Sequence[Sequence[Floats]]) -> Floats:
        """Return cutting force and thrust of each element as components. (states, elements, parts · components)."""
        each = [part[..., None] * way for which, way in zip(parts, self.directions, strict=True) for part in which]
        return np.concatenate(each, axis=2)


def _weighted_sum(shares: Floats, each: Floats) -> Floats:
    return np.asarray((shares[:, None, :] @ each)[:, 0])


def _nose_strips(chips: Sequence[RoundChip], components: Sequence[int]) -> _Strips:
    """Return the elements of round noses in steady cuts, one state each; axial, feed, cutting."""
    middle, thickness, area = (np.empty((len(chips), 2 * NOSE_ELEMENTS)) for _ in range(3))
    least, most = np.empty_like(middle), np.empty_like(middle)
    for i, chip in enumerate(chips):
        low, high = chip.sweep
        corner = min(max(chip.corner, low), high)
        ends = np.concatenate(
            (np.linspace(low, corner, NOSE_ELEMENTS + 1), np.linspace(corner, high, NOSE_ELEMENTS + 1)[1:])
        )
        middle[i] = (ends[1:] + ends[:-1]) / 2
        thickness[i], border = chip.thickness(middle[i]), chip.thickness(ends)
        area[i] = thickness[i] * (chip.nose_radius - thickness[i] / 2) * np.diff(ends)
        least[i], most[i] = np.minimum(border[1:], border[:-1]), np.maximum(border[1:], border[:-1])
    zero = np.zeros_like(middle)
    normal = np.stack((np.cos(middle), np.sin(middle), zero), axis=-1)
    along = np.stack((zero, zero, zero + 1), axis=-1)
    return _Strips((least, thickness, most), area, along, normal, components)


def _tooth_strips(geometry: SlotMill | FlyCut, components: Sequence[int]) -> tuple[_Strips, Floats]:
    """Return the elements of one tooth while it cuts, and the borders of its angles; x, y, z."""
    if isinstance(geometry, SlotMill):
        borders = np.linspace(geometry.entry, geometry.exit, ENGAGED_ANGLES + 1)
        sweeps, arc, wall = np.empty(0), 0.0, max(geometry.depth - geometry.corner_radius, 0.0)
        if geometry.corner_radius:
            arc = float(np.arccos(1 - min(geometry.depth / geometry.corner_radius, 1.0)))
            sweeps = np.linspace(0.0, arc, TOOTH_ELEMENTS + 1)
        # The wall is one more element next to those of the corner.
        s = np.concatenate(((sweeps[1:] + sweeps[:-1]) / 2, np.full(1 if wall else 0, np.pi / 2)))
        length = np.concatenate((geometry.corner_radius * np.diff(sweeps), np.full(1 if wall else 0, wall)))
        ends = [np.concatenate((border, np.full(1 if wall else 0, np.pi / 2))) for border in (sweeps[:-1], sweeps[1:])]
        phi = (borders[1:] + borders[:-1]) / 2
        inner = np.clip(borders, geometry.entry, geometry.exit)
        t = geometry.thickness(phi)[:, None] * np.sin(s)
        corners = [geometry.thickness(at)[:, None] * np.sin(end) for at in (inner[:-1], inner[1:]) for end in ends]
        area = t * length
        turn = phi[:, None] + 0 * s
        along = np.stack((np.sin(turn), np.cos(turn), 0 * turn), axis=-1)
        normal = np.stack((-np.cos(turn) * np.sin(s), np.sin(turn) * np.sin(s), np.cos(s) + 0 * turn), axis=-1)
    else:
        borders = np.linspace(-geometry.exit, geometry.exit, ENGAGED_ANGLES + 1)
        low = -float(np.arcsin(geometry.step / (2 * geometry.nose_radius)))
        high = RoundChip(nose_radius=geometry.nose_radius, feed=geometry.step, depth=geometry.depth).sweep[1]
        sweeps = np.linspace(low, high, TOOTH_ELEMENTS + 1)
        s, phi = (sweeps[1:] + sweeps[:-1]) / 2, (borders[1:] + borders[:-1]) / 2
        t = geometry.thickness(phi[:, None], s)
        at = geometry.thickness(borders[:, None], sweeps)
        corners = [at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]]
        area = t * (geometry.nose_radius - t / 2) * np.diff(sweeps)
        turn = phi[:, None] + 0 * s
        along = np.stack((0 * turn, np.cos(turn), -np.sin(turn)), axis=-1)
        normal = np.stack((np.sin(s) + 0 * turn, np.cos(s) * np.sin(turn), np.cos(s) * np.cos(turn)), axis=-1)
    around = np.stack([*corners, t])
    return _Strips((around.min(axis=0), t, around.max(axis=0)), area, along, normal, components), borders


class EdgeRows(Rows):
    """Rows of chips of varying thickness along the edge."""

    even = False
    """Whether the thickness is uniform, so that the forces jump where the limit is crossed."""

    def transition(self, confidence: float) -> Transition | None:
        """Return the critical thickness with its interval; ``None`` if the forces show no transition."""
        return _transition(self, confidence)


class TurningRows(EdgeRows):
    """Rows of steady cuts."""

    def __init__(self, cuts: NoseCuts, drift: int | None) -> None:
        engaged = cuts.feed > 0
        n = cuts.feed.size
        table = np.column_stack((cuts.nose_radius, cuts.depth, cuts.feed))
        states, index = np.unique(table[engaged], axis=0, return_inverse=True)
        components = [TURNED.index(name) for name in cuts.components]
        self.strips = _nose_strips(
            [RoundChip(nose_radius=float(r), depth=float(d), feed=float(f)) for r, d, f in states], components
        )
        self.state = np.full(n, -1)
        self.state[engaged] = index.reshape(-1)
        thickest = np.zeros(n)
        thickest[engaged] = self.strips.thickest[self.state[engaged]]
        super().__init__(
            cuts.force, cuts.components, engaged, thickest,
            time=cuts.time, record=cuts.record, drift=drift, uncertainty=cuts.uncertainty,
        )  # fmt: skip
        self.labels = tuple(LABELS[name] for name in cuts.components)
        self.reference = _mean_thickness([self.strips])

    def columns(self, limit: float) -> Floats:
        """Return the design matrix, see `Rows.columns`."""
        of_state = self.strips.columns(limit, self.edge, self.power, self.reference)
        columns = np.zeros((self.state.size, *of_state.shape[1:]))
        columns[self.engaged] = of_state[self.state[self.engaged]]
        return columns


class InterruptedRows(EdgeRows):
    """Rows of a rotating cutter."""

    turns = True

    def __init__(self, cuts: InterruptedCuts, drift: int | None) -> None:
        self.cuts = cuts
        self.cache: tuple[object, list[Floats]] | None = None  # key and value of the last tables
        components = [MILLED.index(name) for name in cuts.components]
        self.teeth = [_tooth_strips(geometry, components) for geometry in cuts.geometry]
        self.spin = np.array(cuts.spindle_rpm) * 2 * np.pi / 60
        engaged = cuts.cut >= 0
        time = (cuts.begin + cuts.end) / 2
        self.passes = np.unique(cuts.cut[engaged])
        self.of = [int(cuts.record[cuts.cut == number][0]) for number in self.passes]
        self.middle = np.array([time[cuts.cut == number].mean() for number in self.passes])
        self.speed, self.phase = self.spin[self.of], np.zeros(self.passes.size)
        self.basis = [_harmonics(borders, number, cuts) for number, (_, borders) in enumerate(self.teeth)]
        thickest_of_record = np.array([strips.thickest.max() for strips, _ in self.teeth])
        thickest = np.where(engaged, thickest_of_record[cuts.record], 0.0)
        super().__init__(
            cuts.force, cuts.components, engaged, thickest,
            time=time, record=cuts.record.astype(np.float64), drift=drift,
        )  # fmt: skip
        self.labels = tuple(f"force along {name}" for name in cuts.components)
        self.reference = _mean_thickness([strips for strips, _ in self.teeth])
        self.even = all(strips.even for strips, _ in self.teeth) and not cuts.whole_turns

    def _mean(self, tables: Sequence[Floats], rate: bool = False) -> Floats:
        """Return the mean of periodic tables over each row, or its derivative with respect to the angle."""
        means = np.zeros((self.cuts.cut.size, *tables[0].shape[1:]))
        for number, which in enumerate(self.passes):
            rows = np.flatnonzero(self.cuts.cut == which)
            table = tables[self.of[number]]
            ends = [
                (self.phase[number] + self.speed[number] * (at[rows] - self.middle[number])) / (2 * np.pi)
                for at in (self.cuts.begin, self.cuts.end)
            ]
            if rate:
                values = [_interpolate_periodic(table, turns) for turns in ends]
                means[rows] = (values[1] - values[0]) / (2 * np.pi * (ends[1] - ends[0])).reshape(
                    -1, *[1] * (table.ndim - 1)
                )
                continue
            total = np.concatenate((np.zeros((1, *table.shape[1:])), np.cumsum(table, axis=0))) / TABLE_ANGLES
            per_turn = total[-1]
            sums = [_interpolate_periodic(total[:-1] + 0.0, turns, per_turn) for turns in ends]
            means[rows] = (sums[1] - sums[0]) / (ends[1] - ends[0]).reshape(-1, *[1] * (table.ndim - 1))
        return means

    def _tables(self, limit: float) -> list[Floats]:
        """Return the filtered columns over a revolution of the cutter, for each geometry. (TABLE_ANGLES, c, p)."""
        key = (limit, self.edge, None if self.power is None else tuple(self.power))
        if self.cache is not None and self.cache[0] == key:
            return self.cache[1]
        tables = []
        for (strips, _), (basis, passed) in zip(self.teeth, self.basis, strict=True):
            each = strips.columns(limit, self.edge, self.power, self.reference)
            spectrum = np.einsum("kij,kjp->kip", passed, basis(each))
            full = np.zeros((TABLE_ANGLES // 2 + 1, *spectrum.shape[1:]), dtype=np.complex128)
            full[: spectrum.shape[0]] = spectrum
            tables.append(np.fft.irfft(full, TABLE_ANGLES, axis=0) * TABLE_ANGLES)
        self.cache = (key, tables)
        return tables

    def columns(self, limit: float) -> Floats:
        """Return the design matrix, see `Rows.columns`."""
        tables = self._tables(limit)
        if self.cuts.whole_turns:
            each = np.array([table.mean(axis=0) for table in tables])
            return np.where(self.engaged[:, None, None], each[self.cuts.record], 0.0)
        return self._mean(tables)

    def unknown(self, answer: Floats, limit: float) -> Floats:
        """Return the derivatives of the forces with respect to phase and speed of each pass."""
        if self.cuts.whole_turns:
            return np.zeros((*self.force.shape, 0))
        shape = [table @ answer[: table.shape[2]] for table in self._tables(limit)]
        slope = self._mean(shape, rate=True)
        time = (self.cuts.begin + self.cuts.end) / 2
        columns = []
        for number, which in enumerate(self.passes):
            by_phase = np.where((self.cuts.cut == which)[:, None], slope, 0.0)
            columns += [by_phase, by_phase * (time - self.middle[number])[:, None]]
        return np.stack(columns, axis=2)

    def design(self, used: Bools, split: Transition | None) -> tuple[Bools, Floats, int]:
        """Return the rows and columns of the final fit, see `Rows.design`, with phase and speed of each pass.

        The cutter angle is determined best by the crossing of the limit, so all rows are used, and the limit is an
        additional unknown.
        """
        if split is None or self.cuts.whole_turns:
            limit, place = np.inf, self.place()
        else:
            used, limit, place = np.ones_like(used), split.value, self.place(beyond=True)
        all_columns = self.columns(limit)
        columns = all_columns[:, :, place]
        answer, parameters = Fit(self, used).solve(columns)[0], np.zeros(all_columns.shape[2])
        parameters[place] = answer
        blocks = [columns, self.unknown(parameters, limit)]
        if split is not None and limit < np.inf:
            step = max((split.high - split.low) / 4, 1e-4 * limit)
            slope = (self.columns(limit + step) - self.columns(limit - step))[:, :, place] @ answer
            blocks.append(slope[:, :, None])
        return used, np.concatenate(blocks, axis=2), len(place)

    def synchronise(self, answer: Floats | None, limit: float) -> None:
        """Estimate speed and phase of each pass: first from the harmonics, then by least squares."""
        if self.cuts.whole_turns:
            return
        if answer is None:
            for number in range(self.passes.size):
                self._estimate_phase(number)
            self._update_thickest()
            return
        moved = Fit(self).solve(np.concatenate((self.columns(limit), self.unknown(answer, limit)), axis=2))[0]
        size = answer.size
        self.phase = self.phase + moved[size::2]
        self.speed = self.speed + moved[size + 1 :: 2]
        self._update_thickest()

    def _estimate_phase(self, number: int) -> None:
        rows = np.flatnonzero(self.cuts.cut == self.passes[number])
        time = (self.cuts.begin + self.cuts.end)[rows] / 2 - self.middle[number]
        force = self.cuts.force[rows] - self.cuts.force[rows].mean(axis=0)
        nominal, block = float(self.spin[self.of[number]]), float((self.cuts.end - self.cuts.begin)[rows[0]])
        turn = 2 * np.pi / nominal
        if block > turn / 4:
            raise InputError(
                f"block must be at most {turn / 4:.3g} s (a quarter of a revolution), got {block:.3g} s: reduce it, or "
                "average over whole revolutions"
            )
        most = max(1, min(24, int(turn / block / 3)))
        order = np.arange(1, most + 1)
        reach = float(np.ptp(time)) + block
        count = int(np.ceil(SPINDLE_SPEED_TOL * nominal * reach * most / 0.5))
        if count > 40_000:
            order, count = order[:4], int(np.ceil(SPINDLE_SPEED_TOL * nominal * reach * 8))
        speed = find_speed(force, time, order, nominal, count)
        measured = np.exp(-1j * speed * np.outer(order, time)) @ force / rows.size
        # Harmonics of both coefficients, averaged over the intervals.
        tables = self._tables(np.inf)[self.of[number]]
        model = (
            np.fft.rfft(tables, axis=0)[order]
            / TABLE_ANGLES
            * np.sinc(order * block * speed / (2 * np.pi))[:, None, None]
        )
        phases = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
        squares = np.empty(phases.size)
        for i, phase in enumerate(phases):
            table = (np.exp(1j * order * phase)[:, None, None] * model).reshape(-1, model.shape[2])
            table = np.concatenate((table.real, table.imag))
            right = np.concatenate((measured.reshape(-1).real, measured.reshape(-1).imag))
            size = np.maximum(np.linalg.norm(table, axis=0), TINY)
            answer = np.linalg.lstsq(table / size, right, rcond=1e-10)[0]
            negative = (answer[:: self.parts] < 0).any()
            squares[i] = np.inf if negative else float(((right - table / size @ answer) ** 2).sum())
        if not np.isfinite(squares).any():
            raise InputError(
                f"the forces of pass {number + 1} have the direction of a cut at no cutter angle: check the channels, "
                "their signs, the spindle speed and the geometry"
            )
        self.speed[number], self.phase[number] = speed, phases[int(np.argmin(squares))]

    def _update_thickest(self) -> None:
        """Update the maximum chip thickness during each row, including the rows before and after it."""
        self.thickest = np.zeros(self.cuts.cut.size)
        for number, which in enumerate(self.passes):
            rows = np.flatnonzero(self.cuts.cut == which)
            geometry, (strips, borders) = self.cuts.geometry[self.of[number]], self.teeth[self.of[number]]
            length = (self.cuts.end - self.cuts.begin)[rows, None]
            begin = self.cuts.begin[rows, None] - length - self.middle[number]
            at = self.phase[number] + self.speed[number] * (begin + 3 * length * np.linspace(0, 1, 25))
            teeth = geometry.teeth if isinstance(geometry, SlotMill) else 1
            chip = np.zeros(at.shape)
            for tooth in range(teeth):
                turned = np.mod(at - tooth * 2 * np.pi / teeth - borders[0], 2 * np.pi) + borders[0]
                tooth_chip = np.interp(turned, (borders[1:] + borders[:-1]) / 2, strips.thickest, right=0.0)
                chip = np.maximum(chip, np.where(turned <= borders[-1], tooth_chip, 0.0))
            self.thickest[rows] = chip.max(axis=1)


def _mean_thickness(strips: Sequence[_Strips]) -> float:
    """Return the geometric mean of the thicknesses, weighted by area."""
    area = np.concatenate([strip.area.reshape(-1) for strip in strips])
    chip = np.concatenate([strip.middle.reshape(-1) for strip in strips])
    return float(np.exp((area[chip > 0] @ np.log(chip[chip > 0])) / area[chip > 0].sum()))


def _harmonics(borders: Floats, number: int, cuts: InterruptedCuts) -> tuple[Callable[[Floats], Complexes], Complexes]:
    """Return the transform of the forces of a tooth to harmonics, and the transfer matrix of the filters.

    (angles, components, k) to (harmonics, components, k).
    """
    from scipy.signal import ZoomFFT  # noqa: PLC0415 - costly to import

    geometry, speed = cuts.geometry[number], cuts.spindle_rpm[number] * 2 * np.pi / 60
    teeth = geometry.teeth if isinstance(geometry, SlotMill) else 1
    turn = 2 * np.pi / speed
    block = float((cuts.end - cuts.begin).min())
    order = np.arange(1 if cuts.whole_turns else min(MAX_HARMONICS, int(np.ceil(8 * turn / block))))
    half = np.pi * order * speed / (2 * np.pi) / cuts.rate_hz
    order, half = order[half < np.pi / 2], half[half < np.pi / 2]
    transfer = np.tile(np.eye(len(cuts.components), dtype=np.complex128), (order.size, 1, 1))
    if cuts.passband is not None:
        transfer = np.asarray(cuts.passband(np.asarray(order * speed / (2 * np.pi), dtype=np.float64)))
        nonzero = np.flatnonzero(np.abs(transfer).max(axis=(1, 2)) > 0)
        last = int(nonzero[-1]) + 1 if nonzero.size else 1
        order, half, transfer = order[:last], half[:last], transfer[:last]
    # Correction for the mean of samples against the mean over time.
    factor = np.where(order % teeth == 0, teeth, 0) / np.sinc(half / np.pi)
    wide, first = float(borders[1] - borders[0]), float(borders[0] + borders[1]) / 2
    factor = factor * np.exp(-1j * order * first) * np.sinc(order * wide / (2 * np.pi)) * wide / (2 * np.pi)
    # The angles do not divide a revolution evenly, so a plain FFT does not give its harmonics.
    zoom = ZoomFFT(borders.size - 1, [0, order.size], order.size, fs=2 * np.pi / wide)
    return lambda each: np.asarray(factor[:, None, None] * zoom(each, axis=0)), transfer


def _interpolate_periodic(table: Floats, turns: Floats, per_turn: Floats | None = None) -> Floats:
    """Interpolate a periodic table linearly at angles in turns; ``per_turn`` is its increase per revolution."""
    place = turns * TABLE_ANGLES
    low = np.floor(place).astype(np.int64)
    column = (-1, *[1] * (table.ndim - 1))
    values, increase = (np.take(table, at, axis=0, mode="wrap") for at in (low, low + 1))
    increase -= values
    if per_turn is not None:
        increase += ((low + 1) % TABLE_ANGLES == 0).reshape(column) * per_turn
        values += (low // TABLE_ANGLES).reshape(column) * per_turn
    increase *= (place - low).reshape(column)
    values += increase
    return values


def _update_weights(rows: EdgeRows, limit: float) -> float:
    """Set the weight of each component from its noise on either side of a limit; return the correlation time."""
    thick = rows.engaged & (rows.thickest > limit)
    if not rows.stated:
        separate = min(np.count_nonzero(thick), np.count_nonzero(~thick)) > 2 * MIN_ROWS
        floor = 1e-9 * np.abs(rows.force).max(axis=0) + TINY
        rows.weights = np.ones_like(rows.force)
        for _ in range(2):
            residual = Fit(rows).solve(rows.columns(limit))[2] / rows.weights
            weights = np.empty_like(residual)
            for group in (thick, ~thick) if separate else (np.ones_like(thick),):
                weights[group] = 1 / np.maximum(np.sqrt((residual[group] ** 2).mean(axis=0)), floor)
            rows.weights = weights
    residual = Fit(rows).solve(rows.columns(limit))[2]
    return max(rows.correlation(residual, group) for group in (thick, rows.engaged & ~thick, ~rows.engaged))


def _transition(rows: EdgeRows, confidence: float) -> Transition | None:
    """Return the critical thickness with its interval; ``None`` if the forces show no transition."""
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    low, high = max(ascending[MIN_ROWS - 1], ascending[-1] / 50), ascending[-MIN_ROWS]
    _update_weights(rows, np.inf)
    if not low < high * (1 - 1e-6) or ascending.size < 2 * MIN_ROWS:
        return None
    fit = Fit(rows)  # with the current weights
    grid = np.geomspace(low, high * (1 - 1e-9), TRIAL_THICKNESSES)

    def squares(limit: float) -> float:
        columns = rows.columns(limit)
        answer, least = fit.solve(columns)[:2]
        unknown = rows.unknown(answer, limit)
        return fit.solve(np.concatenate((columns, unknown), axis=2))[1] if unknown.shape[2] else least

    rough = grid[::3]
    tau = _update_weights(rows, float(rough[int(np.argmin([squares(float(limit)) for limit in rough]))]))
    fit = Fit(rows)
    profile = np.array([squares(float(limit)) for limit in grid])
    exact = 1e-4 * float(grid[int(np.argmin(profile))])
    best, least, within = interval(squares, grid, profile, exact, every=True)
    columns = rows.columns(best)
    number, size = rows.force.size, columns.shape[2]
    free = max(number / tau - size - rows.drift.shape[1] * rows.force.shape[1], 1.0)
    answer, _, residual = fit.solve(columns)
    # The weights come from the residuals, so the sum of squares is divided by the degrees of freedom.
    eta = tau * max(
        least / max(number - size, 1),
        1.0 if rows.stated else 0.0,
        _variance_ratio(fit, columns, answer, residual, best),
    )
    limit = hansen(confidence) if rows.even else float(f.ppf(confidence, 1, free))
    ends = within(limit * eta, (0.0, float(ascending[-1])), BISECTIONS)
    extra = 2 * len(rows.determined)
    gain = (squares(np.inf) - least) / eta / extra
    chance = float(min(1.0, rows.engaged.sum() * f.sf(gain, extra, free)))
    which = [tuple(FORCE_NAMES).index(name) for name in rows.determined]
    # An interval that includes 0 is not a transition: the forces are not proportional anywhere.
    if chance > MAX_CHANCE or ends[0] == 0 or rows.remaining(which[0], answer, float(ascending[-1])) >= 1:
        return None
    remaining = tuple(rows.remaining(coefficient, answer, best) for coefficient in which)
    return Transition(best, min(ends[0], best), max(ends[1], best), remaining, chance)


def _variance_ratio(fit: Fit, columns: Floats, answer: Floats, residual: Floats, limit: float) -> float:
    """Return the noise variance of the score for the limit, over that of independent components of a row."""
    rows, step = fit.rows, 0.01 * limit
    slope = (rows.columns(limit + step) - rows.columns(limit - step)) @ answer
    target, table = fit.table(slope[:, :, None]).reshape(-1), fit.table(columns).reshape(-1, columns.shape[2])
    table = table / np.maximum(np.linalg.norm(table, axis=0), TINY)
    free = target - table @ np.linalg.lstsq(table, target, rcond=1e-10)[0]
    total = float(free @ free)
    return float(((free.reshape(residual.shape) * residual).sum(axis=1) ** 2).sum() / total) if total else 0.0
