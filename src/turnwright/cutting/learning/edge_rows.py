r"""Chips that are not equally thick along the edge: columns for any critical thickness, and how it is found.

Every element of an edge adds Kc dA along the cut and Kt dA along its normal. For constant coefficients each measured
component of the force is linear in both, with integrals of the chip's area and of the edge's directions that the
geometry alone decides. Beyond the critical thickness the elements leave that line, and only those beyond it do,

.. math::
    F = d(t) + K_c \int_{h \le h_c} e_c\,dA + K_t \int_{h \le h_c} e_t\,dA
      + \int_{h > h_c} \frac{(q_0 + q_1 h)\,e_c + (p_0 + p_1 h)\,e_t}{h}\,dA ,

so that every component of every cut is one equation of the same six numbers and :math:`h_c`. Of a nose that cuts beyond
:math:`h_c` a part is still below it: the forces change smoothly where the limit is crossed. The critical thickness is
then found as any parameter is, and its interval holds all :math:`h_c` for which

.. math:: \frac{S(h_c) - S(\hat h_c)}{\tau} \le F_{1,\nu}(p),

with the squares S in units of the noise of each component, within the ductile range and beyond it apart, and the
correlation time τ. Where the chip is equally thick along the edge the forces jump, and Hansen's limit holds instead, as
for straight edges. Coefficients come from rows that are ductile all along the edge at every limit in that interval.

An edge is cut into elements, each with the least and the largest thickness on it, so that what is beyond a limit
changes smoothly with the limit. For a cutter that turns the columns go over its angle, pass the filters that the forces
have passed, harmonic by harmonic, and are averaged over the same stretches of time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turnwright._arrays import Bools, Complexes, Floats
from turnwright.cutting.chip import RoundChip
from turnwright.cutting.forces import FlyCut, SlotMill
from turnwright.cutting.learning.cuts import MILLED, OFF_SPEED, TURNED, InterruptedCuts, NoseCuts
from turnwright.cutting.learning.fit import CERTAIN, TINY, Fit, hansen, interval
from turnwright.cutting.learning.learned import NAMES, Transition
from turnwright.cutting.learning.rows import FEWEST, Rows
from turnwright.errors import InputError

__all__ = ["InterruptedRows", "TurningRows"]

PIECES = 256
"""Elements on each smooth piece of a nose in a steady cut."""

ANGLES = 512
"""Angles of the cutter at which a tooth is looked at while it cuts."""

ACROSS = 96
"""Elements along the nose of a fly-cutter, or round the corner of a mill."""

HARMONICS = 4096
"""Most harmonics of a turn that are followed; averages over stretches leave nothing of higher ones."""

GRID = 1 << 13
"""Angles of a turn at which forces are tabled after the filter."""

LABELS = {"axial": "axial force", "feed": "feed force", "cutting": "cutting force"}
"""What components of the force are called; those of a mill are named after their axes."""

LOOKED = 96
"""Thicknesses at which a transition is first looked for."""

HALVED = 12
"""Times that the interval between two of these is halved."""


class _Strips:
    """Elements of an edge at some states of the cut, (states, elements), and what each adds to the forces."""

    def __init__(
        self, thickness: tuple[Floats, Floats, Floats], area: Floats, along: Floats, normal: Floats, kept: Sequence[int]
    ) -> None:
        """Take thicknesses (least, middle, most), areas and the directions of cut and normal, (..., 3)."""
        self.least, self.middle, self.most = thickness
        self.area = area
        self.directions = (along[..., kept], normal[..., kept])
        self.thickest = self.most.max(axis=1)
        self.even = bool((np.where(area > 0, self.middle, np.inf).min(axis=1) >= 0.99 * self.middle.max(axis=1)).all())
        self.width = np.divide(area, self.middle, out=np.zeros_like(area), where=self.middle > 0)
        self.beyond = self._forces([[self.width, area]] * 2)
        self.known: tuple[object, Floats] | None = None  # the table of ductile forces that was asked for last

    def columns(self, limit: float, edge: bool, power: Sequence[float] | None, reference: float) -> Floats:
        """Return what each parameter is multiplied by. (states, components, parameters).

        For the cutting coefficient: ductile area, edge or bend; then the same for thrust; then what is beyond the
        limit per width and per area, for both.
        """
        ductile = self._ductile(edge, power, reference)
        if np.isfinite(limit):
            span = np.maximum(self.most - self.least, 1e-12 * limit)
            below = np.clip((limit - self.least) / span, 0.0, 1.0)
            found = [_summed(below, ductile), _summed(1 - below, self.beyond)]
        else:
            found = [ductile.sum(axis=1)]
        each = np.concatenate(found, axis=1).reshape(self.area.shape[0], -1, self.directions[0].shape[-1])
        return each.transpose(0, 2, 1)

    def _ductile(self, edge: bool, power: Sequence[float] | None, reference: float) -> Floats:
        """Return what each element adds to the columns of both coefficients while it is ductile."""
        asked = (edge, None if power is None else tuple(power), reference)
        if self.known is None or self.known[0] != asked:
            if power is not None:
                ratio = np.where(self.middle > 0, self.middle, reference) / reference
                falling = [self.area * ratio**-one for one in power]
                parts = [[one, -one * np.log(ratio)] for one in falling]
            else:
                parts = [[self.area, self.width] if edge else [self.area]] * 2
            self.known = asked, self._forces(parts)
        return self.known[1]

    def _forces(self, parts: Sequence[Sequence[Floats]]) -> Floats:
        """Return parts of the cutting force and of the thrust as components. (states, elements, parts · components)."""
        each = [part[..., None] * way for which, way in zip(parts, self.directions, strict=True) for part in which]
        return np.concatenate(each, axis=2)


def _summed(shares: Floats, each: Floats) -> Floats:
    """Return sums over the elements of shares of what each adds. (states, elements) of (states, elements, k)."""
    return np.asarray((shares[:, None, :] @ each)[:, 0])


def _nose_strips(chips: Sequence[RoundChip], kept: Sequence[int]) -> _Strips:
    """Return the elements of round noses in steady cuts, a state each; axial, feed, cutting."""
    middle, thickness, area = (np.empty((len(chips), 2 * PIECES)) for _ in range(3))
    least, most = np.empty_like(middle), np.empty_like(middle)
    for i, chip in enumerate(chips):
        low, high = chip.sweep
        corner = min(max(chip.corner, low), high)
        ends = np.concatenate((np.linspace(low, corner, PIECES + 1), np.linspace(corner, high, PIECES + 1)[1:]))
        middle[i] = (ends[1:] + ends[:-1]) / 2
        thickness[i], border = chip.thickness(middle[i]), chip.thickness(ends)
        area[i] = thickness[i] * (chip.nose_radius - thickness[i] / 2) * np.diff(ends)
        least[i], most[i] = np.minimum(border[1:], border[:-1]), np.maximum(border[1:], border[:-1])
    zero = np.zeros_like(middle)
    normal = np.stack((np.cos(middle), np.sin(middle), zero), axis=-1)
    along = np.stack((zero, zero, zero + 1), axis=-1)
    return _Strips((least, thickness, most), area, along, normal, kept)


def _tooth_strips(geometry: SlotMill | FlyCut, kept: Sequence[int]) -> tuple[_Strips, Floats]:
    """Return the elements of one tooth while it cuts, and the borders of the angles; x, y, z."""
    if isinstance(geometry, SlotMill):
        borders = np.linspace(geometry.entry, geometry.exit, ANGLES + 1)
        sweeps, arc, wall = np.empty(0), 0.0, max(geometry.depth - geometry.corner_radius, 0.0)
        if geometry.corner_radius:
            arc = float(np.arccos(1 - min(geometry.depth / geometry.corner_radius, 1.0)))
            sweeps = np.linspace(0.0, arc, ACROSS + 1)
        # The wall is one more element beside those of the corner.
        s = np.concatenate(((sweeps[1:] + sweeps[:-1]) / 2, np.full(1 if wall else 0, np.pi / 2)))
        length = np.concatenate((geometry.corner_radius * np.diff(sweeps), np.full(1 if wall else 0, wall)))
        ends = [np.concatenate((one, np.full(1 if wall else 0, np.pi / 2))) for one in (sweeps[:-1], sweeps[1:])]
        phi = (borders[1:] + borders[:-1]) / 2
        inner = np.clip(borders, geometry.entry, geometry.exit)
        t = geometry.thickness(phi)[:, None] * np.sin(s)
        corners = [geometry.thickness(at)[:, None] * np.sin(end) for at in (inner[:-1], inner[1:]) for end in ends]
        area = t * length
        turn = phi[:, None] + 0 * s
        along = np.stack((np.sin(turn), np.cos(turn), 0 * turn), axis=-1)
        normal = np.stack((-np.cos(turn) * np.sin(s), np.sin(turn) * np.sin(s), np.cos(s) + 0 * turn), axis=-1)
    else:
        borders = np.linspace(-geometry.exit, geometry.exit, ANGLES + 1)
        low = -float(np.arcsin(geometry.step / (2 * geometry.nose_radius)))
        high = RoundChip(nose_radius=geometry.nose_radius, feed=geometry.step, depth=geometry.depth).sweep[1]
        sweeps = np.linspace(low, high, ACROSS + 1)
        s, phi = (sweeps[1:] + sweeps[:-1]) / 2, (borders[1:] + borders[:-1]) / 2
        t = geometry.thickness(phi[:, None], s)
        at = geometry.thickness(borders[:, None], sweeps)
        corners = [at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]]
        area = t * (geometry.nose_radius - t / 2) * np.diff(sweeps)
        turn = phi[:, None] + 0 * s
        along = np.stack((0 * turn, np.cos(turn), -np.sin(turn)), axis=-1)
        normal = np.stack((np.sin(s) + 0 * turn, np.cos(s) * np.sin(turn), np.cos(s) * np.cos(turn)), axis=-1)
    around = np.stack([*corners, t])
    return _Strips((around.min(axis=0), t, around.max(axis=0)), area, along, normal, kept), borders


class EdgeRows(Rows):
    """Rows of chips that are not equally thick along the edge."""

    even = False
    """Whether they are all the same, so that the forces jump where the limit is crossed."""

    def transition(self, confidence: float) -> Transition | None:
        """Find the thickness beyond which elements of the edge leave the ductile line, and all that could be it."""
        return _transition(self, confidence)


class TurningRows(EdgeRows):
    """Rows of steady cuts."""

    def __init__(self, cuts: NoseCuts, drift: int | None) -> None:
        engaged = cuts.feed > 0
        n = cuts.feed.size
        table = np.column_stack((cuts.nose_radius, cuts.depth, cuts.feed))
        states, index = np.unique(table[engaged], axis=0, return_inverse=True)
        kept = [TURNED.index(one) for one in cuts.components]
        self.strips = _nose_strips(
            [RoundChip(nose_radius=float(r), depth=float(d), feed=float(f)) for r, d, f in states], kept
        )
        self.state = np.full(n, -1)
        self.state[engaged] = index.reshape(-1)
        thickest = np.zeros(n)
        thickest[engaged] = self.strips.thickest[self.state[engaged]]
        super().__init__(
            cuts.force, cuts.components, engaged, thickest,
            time=cuts.time, record=cuts.record, drift=drift, uncertainty=cuts.uncertainty,
        )  # fmt: skip
        self.labels = tuple(LABELS[one] for one in cuts.components)
        self.reference = _typical([self.strips])

    def columns(self, limit: float) -> Floats:
        """Return what each parameter is multiplied by. See its base."""
        each = self.strips.columns(limit, self.edge, self.power, self.reference)
        found = np.zeros((self.state.size, *each.shape[1:]))
        found[self.engaged] = each[self.state[self.engaged]]
        return found


class InterruptedRows(EdgeRows):
    """Rows of a cutter that turns."""

    turns = True

    def __init__(self, cuts: InterruptedCuts, drift: int | None) -> None:
        self.cuts = cuts
        self.known: tuple[object, list[Floats]] | None = None  # tables that were asked for last
        kept = [MILLED.index(one) for one in cuts.components]
        self.teeth = [_tooth_strips(one, kept) for one in cuts.geometry]
        self.spin = np.array(cuts.spindle_rpm) * 2 * np.pi / 60
        engaged = cuts.cut >= 0
        time = (cuts.begin + cuts.end) / 2
        self.passes = np.unique(cuts.cut[engaged])
        self.of = [int(cuts.record[cuts.cut == one][0]) for one in self.passes]
        self.middle = np.array([time[cuts.cut == one].mean() for one in self.passes])
        self.speed, self.phase = self.spin[self.of], np.zeros(self.passes.size)
        self.basis = [_harmonics(borders, number, cuts) for number, (_, borders) in enumerate(self.teeth)]
        most = np.array([one.thickest.max() for one, _ in self.teeth])
        thickest = np.where(engaged, most[cuts.record], 0.0)
        super().__init__(
            cuts.force, cuts.components, engaged, thickest,
            time=time, record=cuts.record.astype(np.float64), drift=drift,
        )  # fmt: skip
        self.labels = tuple(f"force along {one}" for one in cuts.components)
        self.reference = _typical([one for one, _ in self.teeth])
        self.even = all(one.even for one, _ in self.teeth) and not cuts.whole_turns

    def _mean(self, tables: Sequence[Floats], rate: bool = False) -> Floats:
        """Return the mean of periodic tables over each row, or how fast it changes with the angle."""
        found = np.zeros((self.cuts.cut.size, *tables[0].shape[1:]))
        for number, which in enumerate(self.passes):
            rows = np.flatnonzero(self.cuts.cut == which)
            table = tables[self.of[number]]
            ends = [
                (self.phase[number] + self.speed[number] * (at[rows] - self.middle[number])) / (2 * np.pi)
                for at in (self.cuts.begin, self.cuts.end)
            ]
            if rate:
                values = [_looked_up(table, one) for one in ends]
                found[rows] = (values[1] - values[0]) / (2 * np.pi * (ends[1] - ends[0])).reshape(
                    -1, *[1] * (table.ndim - 1)
                )
                continue
            total = np.concatenate((np.zeros((1, *table.shape[1:])), np.cumsum(table, axis=0))) / GRID
            whole = total[-1]
            sums = [_looked_up(total[:-1] + 0.0, one, whole) for one in ends]
            found[rows] = (sums[1] - sums[0]) / (ends[1] - ends[0]).reshape(-1, *[1] * (table.ndim - 1))
        return found

    def _tables(self, limit: float) -> list[Floats]:
        """Return the columns over a turn of the cutter, after the filters, for each geometry. (GRID, c, p)."""
        asked = (limit, self.edge, None if self.power is None else tuple(self.power))
        if self.known is not None and self.known[0] == asked:
            return self.known[1]
        tables = []
        for (strips, _), (basis, passed) in zip(self.teeth, self.basis, strict=True):
            each = strips.columns(limit, self.edge, self.power, self.reference)
            spectrum = np.einsum("kij,kjp->kip", passed, basis(each))
            full = np.zeros((GRID // 2 + 1, *spectrum.shape[1:]), dtype=np.complex128)
            full[: spectrum.shape[0]] = spectrum
            tables.append(np.fft.irfft(full, GRID, axis=0) * GRID)
        self.known = (asked, tables)
        return tables

    def columns(self, limit: float) -> Floats:
        """Return what each parameter is multiplied by. See its base."""
        tables = self._tables(limit)
        if self.cuts.whole_turns:
            each = np.array([table.mean(axis=0) for table in tables])
            return np.where(self.engaged[:, None, None], each[self.cuts.record], 0.0)
        return self._mean(tables)

    def unknown(self, answer: Floats, limit: float) -> Floats:
        """Return what the force changes by with the phase and the speed of each pass."""
        if self.cuts.whole_turns:
            return np.zeros((*self.force.shape, 0))
        shape = [table @ answer[: table.shape[2]] for table in self._tables(limit)]
        slope = self._mean(shape, rate=True)
        time = (self.cuts.begin + self.cuts.end) / 2
        columns = []
        for number, which in enumerate(self.passes):
            mine = np.where((self.cuts.cut == which)[:, None], slope, 0.0)
            columns += [mine, mine * (time - self.middle[number])[:, None]]
        return np.stack(columns, axis=2)

    def design(self, used: Bools, split: Transition | None) -> tuple[Bools, Floats, int]:
        """Return rows and columns of the coefficients, with what places the cutter beside them. See the base.

        Its place follows best from when the limit is crossed, so that all rows take part; how the forces depend on
        the limit is one more unknown.
        """
        if split is None or self.cuts.whole_turns:
            limit, place = np.inf, self.place()
        else:
            used, limit, place = np.ones_like(used), split.value, self.place(beyond=True)
        every = self.columns(limit)
        columns = every[:, :, place]
        answer, whole = Fit(self, used).solve(columns)[0], np.zeros(every.shape[2])
        whole[place] = answer
        found = [columns, self.unknown(whole, limit)]
        if split is not None and limit < np.inf:
            step = max((split.high - split.low) / 4, 1e-4 * limit)
            slope = (self.columns(limit + step) - self.columns(limit - step))[:, :, place] @ answer
            found.append(slope[:, :, None])
        return used, np.concatenate(found, axis=2), len(place)

    def synchronise(self, answer: Floats | None, limit: float) -> None:
        """Find speed and phase of each pass: from the harmonics first, then by least squares."""
        if self.cuts.whole_turns:
            return
        if answer is None:
            for number in range(self.passes.size):
                self._catch(number)
            self._look_at_chips()
            return
        moved = Fit(self).solve(np.concatenate((self.columns(limit), self.unknown(answer, limit)), axis=2))[0]
        size = answer.size
        self.phase = self.phase + moved[size::2]
        self.speed = self.speed + moved[size + 1 :: 2]
        self._look_at_chips()

    def _catch(self, number: int) -> None:
        """Find speed and phase of one pass without knowing either well."""
        rows = np.flatnonzero(self.cuts.cut == self.passes[number])
        time = (self.cuts.begin + self.cuts.end)[rows] / 2 - self.middle[number]
        force = self.cuts.force[rows] - self.cuts.force[rows].mean(axis=0)
        nominal, block = float(self.spin[self.of[number]]), float((self.cuts.end - self.cuts.begin)[rows[0]])
        turn = 2 * np.pi / nominal
        if block > turn / 4:
            raise InputError(
                f"the stretches are {block:.3g} s long and the cutter turns once in {turn:.3g} s: take at most a "
                "quarter of that, or average over whole turns"
            )
        most = max(1, min(24, int(turn / block / 3)))
        order = np.arange(1, most + 1)
        reach = float(np.ptp(time)) + block
        count = int(np.ceil(OFF_SPEED * nominal * reach * most / 0.5))
        if count > 40_000:
            order, count = order[:4], int(np.ceil(OFF_SPEED * nominal * reach * 8))
        speeds = nominal * (1 + OFF_SPEED * np.linspace(-1, 1, 2 * count + 1))

        def heard(speed: float) -> Complexes:
            return np.asarray(np.exp(-1j * speed * np.outer(order, time)) @ force / rows.size)

        power = np.array([(np.abs(heard(one)) ** 2).sum() for one in speeds])
        speed = float(speeds[int(np.argmax(power))])
        said = heard(speed)
        # The harmonics of both coefficients, as the means over stretches show them.
        tables = self._tables(np.inf)[self.of[number]]
        model = np.fft.rfft(tables, axis=0)[order] / GRID * np.sinc(order * block * speed / (2 * np.pi))[:, None, None]
        phases = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
        left = np.empty(phases.size)
        for i, phase in enumerate(phases):
            table = (np.exp(1j * order * phase)[:, None, None] * model).reshape(-1, model.shape[2])
            table = np.concatenate((table.real, table.imag))
            right = np.concatenate((said.reshape(-1).real, said.reshape(-1).imag))
            size = np.maximum(np.linalg.norm(table, axis=0), TINY)
            found = np.linalg.lstsq(table / size, right, rcond=1e-10)[0]
            wrong = (found[:: self.parts] < 0).any()
            left[i] = np.inf if wrong else float(((right - table / size @ found) ** 2).sum())
        if not np.isfinite(left).any():
            raise InputError(
                f"at no position of the cutter do the forces of pass {number + 1} point as those of a cut do: check "
                "the channels, their signs, the speed of the spindle and the geometry"
            )
        self.speed[number], self.phase[number] = speed, phases[int(np.argmin(left))]

    def _look_at_chips(self) -> None:
        """Find the thickest place of the edge while each row lasts, a row before and after with it."""
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
                one = np.interp(turned, (borders[1:] + borders[:-1]) / 2, strips.thickest, right=0.0)
                chip = np.maximum(chip, np.where(turned <= borders[-1], one, 0.0))
            self.thickest[rows] = chip.max(axis=1)


def _typical(strips: Sequence[_Strips]) -> float:
    """Return the geometric mean of the thicknesses, each counted by its area."""
    area = np.concatenate([one.area.reshape(-1) for one in strips])
    chip = np.concatenate([one.middle.reshape(-1) for one in strips])
    return float(np.exp((area[chip > 0] @ np.log(chip[chip > 0])) / area[chip > 0].sum()))


class _Harmonics:
    """What takes the forces of a tooth at its angles to the first harmonics of a turn."""

    def __init__(self, borders: Floats, factor: Complexes) -> None:
        """Take the borders of the angles, and what each harmonic is multiplied by."""
        from scipy.signal import ZoomFFT  # noqa: PLC0415 - costly to import

        wide, count = float(borders[1] - borders[0]), factor.size
        # The angles are no share of a turn, so that a plain transform has none of the harmonics.
        self.transform = ZoomFFT(borders.size - 1, [0, count], count, fs=2 * np.pi / wide)
        order, first = np.arange(count), float(borders[0] + borders[1]) / 2
        self.factor = factor * np.exp(-1j * order * first) * np.sinc(order * wide / (2 * np.pi)) * wide / (2 * np.pi)

    def __call__(self, each: Floats) -> Complexes:
        """Return the harmonics of columns. (angles, components, k) to (harmonics, components, k)."""
        return np.asarray(self.factor[:, None, None] * self.transform(each, axis=0))


def _harmonics(borders: Floats, number: int, cuts: InterruptedCuts) -> tuple[_Harmonics, Complexes]:
    """Return what takes the forces of a tooth at its angles to the harmonics of a turn, and what filters leave."""
    geometry, speed = cuts.geometry[number], cuts.spindle_rpm[number] * 2 * np.pi / 60
    teeth = geometry.teeth if isinstance(geometry, SlotMill) else 1
    turn = 2 * np.pi / speed
    block = float((cuts.end - cuts.begin).min())
    order = np.arange(1 if cuts.whole_turns else min(HARMONICS, int(np.ceil(8 * turn / block))))
    half = np.pi * order * speed / (2 * np.pi) / cuts.rate_hz
    order, half = order[half < np.pi / 2], half[half < np.pi / 2]
    passed = np.tile(np.eye(len(cuts.components), dtype=np.complex128), (order.size, 1, 1))
    if cuts.passband is not None:
        passed = np.asarray(cuts.passband(np.asarray(order * speed / (2 * np.pi), dtype=np.float64)))
        heard = np.flatnonzero(np.abs(passed).max(axis=(1, 2)) > 0)
        last = int(heard[-1]) + 1 if heard.size else 1
        order, half, passed = order[:last], half[:last], passed[:last]
    # A mean of samples is a little more than the mean over the time between the first and the last.
    factor = np.where(order % teeth == 0, teeth, 0) / np.sinc(half / np.pi)
    return _Harmonics(borders, factor.astype(np.complex128)), passed


def _looked_up(table: Floats, turns: Floats, whole: Floats | None = None) -> Floats:
    """Return a periodic table at some turns, between its entries by lines; ``whole`` is what a turn adds to it."""
    place = turns * GRID
    low = np.floor(place).astype(np.int64)
    column = (-1, *[1] * (table.ndim - 1))
    found, after = (np.take(table, at, axis=0, mode="wrap") for at in (low, low + 1))
    after -= found
    if whole is not None:
        after += ((low + 1) % GRID == 0).reshape(column) * whole
        found += (low // GRID).reshape(column) * whole
    after *= (place - low).reshape(column)
    found += after
    return found


def _weigh(rows: EdgeRows, limit: float) -> float:
    """Weigh each component by its noise, within the ductile range and beyond apart; return the correlation time."""
    thick = rows.engaged & (rows.thickest > limit)
    if not rows.stated:
        apart = min(np.count_nonzero(thick), np.count_nonzero(~thick)) > 2 * FEWEST
        floor = 1e-9 * np.abs(rows.force).max(axis=0) + TINY
        rows.weights = np.ones_like(rows.force)
        for _ in range(2):
            left = Fit(rows).solve(rows.columns(limit))[2] / rows.weights
            weights = np.empty_like(left)
            for group in (thick, ~thick) if apart else (np.ones_like(thick),):
                weights[group] = 1 / np.maximum(np.sqrt((left[group] ** 2).mean(axis=0)), floor)
            rows.weights = weights
    left = Fit(rows).solve(rows.columns(limit))[2]
    return max(rows.together(left, one) for one in (thick, rows.engaged & ~thick, ~rows.engaged))


def _transition(rows: EdgeRows, confidence: float) -> Transition | None:
    """Find the thickness beyond which elements of the edge leave the ductile line, and all that could be it."""
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    low, high = max(ascending[FEWEST - 1], ascending[-1] / 50), ascending[-FEWEST]
    _weigh(rows, np.inf)
    if not low < high * (1 - 1e-6) or ascending.size < 2 * FEWEST:
        return None
    fit = Fit(rows)  # as the rows are weighed now
    grid = np.geomspace(low, high * (1 - 1e-9), LOOKED)

    def squares(limit: float) -> float:
        columns = rows.columns(limit)
        answer, least = fit.solve(columns)[:2]
        beside = rows.unknown(answer, limit)
        return fit.solve(np.concatenate((columns, beside), axis=2))[1] if beside.shape[2] else least

    rough = grid[::3]
    tau = _weigh(rows, float(rough[int(np.argmin([squares(float(one)) for one in rough]))]))
    fit = Fit(rows)
    profile = np.array([squares(float(one)) for one in grid])
    exact = 1e-4 * float(grid[int(np.argmin(profile))])
    best, least, within = interval(squares, grid, profile, exact, every=True)
    columns = rows.columns(best)
    number, size = rows.force.size, columns.shape[2]
    free = max(number / tau - size - rows.drift.shape[1] * rows.force.shape[1], 1.0)
    answer, _, left = fit.solve(columns)
    # Weights were made from the residuals, so that a square counts as number over degrees of freedom.
    eta = tau * max(
        least / max(number - size, 1), 1.0 if rows.stated else 0.0, _told_by(fit, columns, answer, left, best)
    )
    limit = hansen(confidence) if rows.even else float(f.ppf(confidence, 1, free))
    ends = within(limit * eta, (0.0, float(ascending[-1])), HALVED)
    more = 2 * len(rows.told)
    gain = (squares(np.inf) - least) / eta / more
    chance = float(min(1.0, rows.engaged.sum() * f.sf(gain, more, free)))
    which = [tuple(NAMES).index(name) for name in rows.told]
    # What could as well begin at no thickness at all is no transition: forces are out of proportion everywhere.
    if chance > CERTAIN or ends[0] == 0 or rows.remaining(which[0], answer, float(ascending[-1])) >= 1:
        return None
    remaining = tuple(rows.remaining(one, answer, best) for one in which)
    return Transition(best, min(ends[0], best), max(ends[1], best), remaining, chance)


def _told_by(fit: Fit, columns: Floats, answer: Floats, left: Floats, limit: float) -> float:
    """Return the noise of what tells the limit over that of independent components; those of a row may hang together.

    What fracture does to one component it does to all.
    """
    rows, step = fit.rows, 0.01 * limit
    slope = (rows.columns(limit + step) - rows.columns(limit - step)) @ answer
    target, table = fit.table(slope[:, :, None]).reshape(-1), fit.table(columns).reshape(-1, columns.shape[2])
    table = table / np.maximum(np.linalg.norm(table, axis=0), TINY)
    rest = target - table @ np.linalg.lstsq(table, target, rcond=1e-10)[0]
    whole = float(rest @ rest)
    return float(((rest.reshape(left.shape) * left).sum(axis=1) ** 2).sum() / whole) if whole else 0.0
