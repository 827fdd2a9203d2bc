"""Reports of runs: self-contained HTML pages for screen and print, and result files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.job import judge, part_shape
from turnwright.path import Motion
from turnwright.post import after_stop, dialect_of
from turnwright.report.archive import (
    archive_comparison,
    archive_correction,
    archive_diagnosis,
    archive_measured,
    archive_run,
    archive_tiled,
    read_maps,
    write_maps,
)
from turnwright.report.comparison import write_comparison
from turnwright.report.measured import write_correction, write_diagnosis, write_measured
from turnwright.report.page import Page, page_file, set_page
from turnwright.report.study import write_study
from turnwright.report.tiled import write_tiled
from turnwright.report.tolerance import write_tolerance
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from turnwright.access import Access
    from turnwright.heightmap import HeightMap
    from turnwright.job import Entry, Job, Prediction, Result, Verdict
    from turnwright.machine import Machine
    from turnwright.motion import Limits
    from turnwright.part import Part
    from turnwright.profile import Profile
    from turnwright.report.figures import Picture
    from turnwright.tool import Tool

__all__ = [
    "archive_comparison",
    "archive_correction",
    "archive_diagnosis",
    "archive_measured",
    "archive_run",
    "archive_tiled",
    "read_maps",
    "write_backplot",
    "write_comparison",
    "write_correction",
    "write_diagnosis",
    "write_maps",
    "write_measured",
    "write_picture",
    "write_report",
    "write_study",
    "write_tiled",
    "write_tolerance",
]

NM = 1e6
TURN = 2 * math.pi

MAX_PICTURED_MAPS = 6
"""Maps shown as pictures; the page states how many more there are."""

LISTED_LINES = 40
"""Program lines shown on the page."""

MAX_PICTURE_POINTS = 20_000
"""Points of a motion drawn in a picture."""


def write_picture(shown: HeightMap | Profile, path: str | PathLike[str]) -> None:
    """Write a picture of a map or a profile as ``.png``, ``.svg`` or ``.pdf``, by the suffix of the file."""
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    draw.write_picture(shown, path)


class _Row(NamedTuple):
    """A named value, with its limit if it has one."""

    name: str
    value: str
    limit: str = ""
    margin: str = ""
    where: str = ""
    ok: bool = True
    share: float | None = None  # value over limit
    binding: bool = False


class _Verdict(NamedTuple):
    """Overall verdict at the top of the page."""

    grade: str  # good, warn or bad
    word: str
    why: str


class _Number(NamedTuple):
    """A key figure at the top of the page."""

    label: str
    value: str
    unit: str
    note: str
    ok: bool = True


class _Block(NamedTuple):
    """A pass: its parameters, and the peak values of its axes."""

    title: str
    facts: str
    rows: list[_Row]


class _ChipRow(NamedTuple):
    """Uncut chip thickness of a pass, with the ductile-mode verdict and its grade."""

    name: str
    verdict: str
    grade: str  # yes, soft or no
    values: tuple[str, ...]


class _Chips(NamedTuple):
    """Uncut chip thickness of all passes."""

    rows: list[_ChipRow]
    note: str


class _Map(NamedTuple):
    """A simulated map."""

    name: str
    note: str
    picture: Picture
    profile: Picture
    servos: tuple[str, Picture] | None  # sentence and map of their contribution


class _Link(NamedTuple):
    """A file; its address if it is in the folder of the page."""

    name: str
    address: str | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Page(Page):
    """Content of the page, passed to the template."""

    verdict: _Verdict
    numbers: Sequence[_Number]
    warnings: Sequence[str]
    facts: Mapping[str, Sequence[_Row]]
    part: Sequence[Picture]
    access: Sequence[_Row]
    access_map: Picture | None
    path: Sequence[Picture]
    spiral: Sequence[_Row]
    approaches: Sequence[Picture]
    approach: Sequence[tuple[str, Sequence[str]]]
    axes: Sequence[Picture]
    passes: Sequence[_Block]
    chips: _Chips | None
    chip_maps: Sequence[Picture]
    maps: Sequence[_Map]
    left_out: int
    parameters: Sequence[tuple[str, str, Sequence[str]]]
    parameter_notes: Sequence[str]
    program: Sequence[_Row]
    files: Sequence[_Link]
    head: str
    timings: Sequence[_Row]
    peak_memory: str


def write_report(result: Result, path: str | PathLike[str]) -> File:
    """Write the page of a run.

    Parameters
    ----------
    result
        Result of the run.
    path
        File, or an existing folder in which the page is named ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path = page_file(path)
    verdicts = result.verdicts
    numbers = _numbers(result.predictions, [cut.limits for cut in result.passes], verdicts)
    failed = _failed(verdicts)
    if result.rounding_nm > result.rounding_limit_nm:
        failed.append("rounding in the program exceeds its limit")
    if failed:
        verdict = _Verdict("bad", "Not ready", "; ".join(failed))
    elif brittle := [cut.name for cut in result.passes if cut.chips is not None and not cut.chips.ok]:
        verdict = _Verdict("warn", "Brittle damage possible", f"not in the ductile regime: {', '.join(brittle)}")
    elif not result.ok:
        verdict = _Verdict("warn", "Ready with exceptions", "exceeds a limit that the job accepts")
    else:
        unevaluated = [one.sentence for one in verdicts if one.is_kept is None]
        met = (
            "tool access, machine limits and tolerances met"
            if len(unevaluated) < len(verdicts)
            else "tool access and machine limits met"
        )
        verdict = _Verdict("warn" if unevaluated else "good", "Ready to cut", "; ".join([met, *unevaluated]))
    feed = result.passes[-1].feed
    maps, left_out = _maps(result.predictions, feed)
    page = _Page(
        title=result.part.name or "unnamed part",
        kind="Run",
        verdict=verdict,
        numbers=numbers,
        warnings=result.warnings,
        facts=_facts(result.part, result.tool, result.actual_tool, result.machine, result.actual_machine),
        part=[draw.sag_map(result.part), draw.view(result.part)],
        access=_access_rows(result.access),
        access_map=draw.access_map(result.part, result.access.findings),
        path=[
            draw.spiral(result.motion, result.revolutions[len(result.revolutions) // 2], feed),
            draw.contact(result.path),
        ],
        spiral=[
            *_spiral_rows(result.revolutions, result.limits, feed),
            _Row("Nose compensation along", "the surface normal" if result.job.strategy.along == "normal" else "z"),
            _Row(
                "Minimum clearance of the cutting edge",
                f"{result.least_clearance * NM + 0.0:.3g} nm (0 is contact, negative is a gouge)",
            ),
        ],
        approaches=[
            draw.approach_view(name, result.entries[name], result.tool)
            for name in dict.fromkeys((result.passes[0].name, result.passes[-1].name))
        ],
        approach=[(name, _approach_facts(one)) for name, one in result.entries.items()],
        axes=[draw.z_over_turns(result.revolutions), draw.axes_over_time(result.motion)],
        passes=[
            _Block(
                title=cut.name,
                facts=" · ".join(
                    [
                        *([f"depth {_length(cut.depth)}, allowance {_length(cut.allowance)}"] if cut.depth else []),
                        f"{cut.feed * 1e3:.4g} µm/rev",
                        f"{cut.spindle_rpm:.4g} rev/min",
                        f"{cut.points:,} points",
                        _duration(cut.limits.cycle_time_s),
                    ]
                ),
                rows=_limit_rows(cut.limits, result.machine),
            )
            for cut in reversed(result.passes)
        ],
        chips=_chip_table(result),
        chip_maps=[
            draw.chip_map(name, result.part, result.chips[name], result.job.part.substance)
            for name in (result.passes[0].name, result.passes[-1].name)[-len(result.chips) :]
            if name in result.chips
        ],
        maps=maps,
        left_out=left_out,
        parameters=_parameters(result.predictions),
        parameter_notes=_parameter_notes(result.predictions),
        program=[
            _Row("Dialect", result.machine.dialect),
            _Row("Lines", f"{result.program.lines:,}"),
            _Row("Size", f"{result.program.bytes / 1e6:.3g} MB"),
            _Row("Cutting time", _duration(result.program.minutes * 60)),
            _Row("Approaches, plunges and retracts", _duration(result.program.links_minutes * 60)),
            _Row("After a stop", ". ".join(after_stop(dialect_of(result.machine))) + "."),
            _Row("SHA-256", result.program.hash),
            _Row(
                "Surface change by rounding in the program",
                f"{result.rounding_nm:.3g} nm",
                f"{result.rounding_limit_nm:.3g} nm",
                ok=result.rounding_nm <= result.rounding_limit_nm,
            ),
        ],
        files=[_link(file, path) for file in result.program.files],
        head=_head(result.program.files[0]) if result.program.files else "",
        timings=_timings(result.timings),
        peak_memory=f"{result.peak_memory_gb:.2f} GB" if math.isfinite(result.peak_memory_gb) else "unknown",
        job=result.job.to_toml(),
    )
    return set_page("run.html.j2", page, path)


def write_backplot(
    program: str | PathLike[str],
    job: Job,
    motion: Motion,
    limits: Limits,
    predictions: Sequence[Prediction],
    path: str | PathLike[str],
) -> File:
    """Write the page of a back-plotted NC program.

    Parameters
    ----------
    program
        Program file.
    job
        Job with the nominal surface, tool and machine of the simulation.
    motion, limits
        Motion of the program and its check against the machine limits.
    predictions
        Simulated surfaces, see `turnwright.job.predict`.
    path
        File, or an existing folder in which the page is named ``report.html``.

    Returns
    -------
    pathlib.Path
        The file written.
    """
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    path, program = page_file(path), File(program)
    part, machine = job.part, job.machine
    verdicts = judge(job, predictions)
    numbers = _numbers(predictions, [limits], verdicts)
    failed = _failed(verdicts)
    if not limits.ok:
        failed.append("a machine limit is exceeded")
    verdict = (
        _Verdict("bad", "Not within limits", "; ".join(failed)) if failed else _Verdict("good", "Within limits", "")
    )
    turns, feed = _single_turns(motion), motion.feed
    shown = _thinned(motion)
    maps, left_out = _maps(predictions, feed)
    page = _Page(
        title=part.name or program.name,
        kind=f"Back-plot of {program.name}",
        verdict=verdict,
        numbers=numbers,
        warnings=[*limits.findings, *(sentence for one in predictions for sentence in one.remarks)],
        facts=_facts(part, job.tool, job.actual_tool, machine, job.actual_machine),
        part=[draw.sag_map(part), draw.view(part)],
        access=[],
        access_map=None,
        path=[draw.spiral(shown, turns[len(turns) // 2], feed)],
        spiral=_spiral_rows(turns, limits, feed),
        approaches=[],
        approach=[],
        axes=[draw.z_over_turns(turns), draw.axes_over_time(shown)],
        passes=[
            _Block(
                title=program.name,
                facts=f"{limits.spindle_rpm:.4g} rev/min · {limits.points:,} points · {_duration(limits.cycle_time_s)}",
                rows=_limit_rows(limits, machine),
            )
        ],
        chips=None,
        chip_maps=[],
        maps=maps,
        left_out=left_out,
        parameters=_parameters(predictions),
        parameter_notes=_parameter_notes(predictions),
        program=[_Row("Size", f"{program.stat().st_size / 1e6:.3g} MB")] if program.is_file() else [],
        files=[_link(program, path)],
        head=_head(program),
        timings=[],
        peak_memory="",
        job=job.to_toml(),
    )
    return set_page("run.html.j2", page, path)


def _approach_facts(entry: Entry) -> tuple[str, ...]:
    """Return the row of an approach: depth, entry, plunge feed, revolutions, time and minimum gap."""
    approach = entry.approach
    if approach.plunge is None:
        return ("none", "clear of the material", "–", "–", "–", _length(entry.least_gap))
    return (
        _length(max(entry.depth or 0.0, 0.0)),
        "plunge with C rotating",
        f"{approach.plunge_feed * 60:.3g} mm/min, {approach.per_rev * 1e3:.3g} µm/rev",
        f"{approach.turns:.0f}",
        _duration(approach.plunge_s),
        _length(entry.least_gap),
    )


def _length(length: float, digits: int = 4) -> str:
    """Format a length in a suitable unit, as in the pictures."""
    return _as_printed(say_length(length, digits))


def _as_printed(text: str) -> str:
    return text.replace(" um", " µm")


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds >= 60 else f"{seconds:.3g} s"


def _chip_table(result: Result) -> _Chips | None:
    """Return the chip table with the ductile-mode check of each pass; ``None`` without chip data."""
    rows: list[_ChipRow] = []
    rakes: list[float] = []
    for cut in result.passes:
        chips = cut.chips
        if chips is None:
            continue
        rakes += chips.rake_range
        force = "–"
        if chips.axial is not None and chips.cutting is not None:
            force = f"{chips.axial * 1e3:.3g} / {chips.cutting * 1e3:.3g} mN"
        margin, limit, feed = "–", "–", "any"
        if chips.margin is not None and chips.critical is not None:
            band = "" if chips.margin_uncertainty is None else f" ± {100 * chips.margin_uncertainty:.3g}"
            margin, limit = f"{100 * chips.margin:.0f}{band} %", _length(chips.critical, 3)
        if chips.largest_feed is not None:
            feed = f"{chips.largest_feed * 1e3:.3g} µm/rev"
        ductile = chips.verdict == "ductile"
        exception = "except on the first revolution" if ductile else "removed by later passes"
        verdict = {"ductile": "ductile", "brittle": "brittle", "uncertain": "uncertain"}[chips.verdict]
        rows.append(
            _ChipRow(
                cut.name,
                verdict if chips.ok == ductile else f"{verdict}, {exception}",
                "no" if not chips.ok else "yes" if ductile else "soft",
                (
                    _length(chips.thickest, 3), limit, margin, _length(chips.typical, 3), feed,
                    "–" if chips.fracture is None else "none" if not chips.fracture else _length(chips.fracture, 3),
                    _length(cut.allowance, 3) if cut.allowance else "none",
                    force,
                    _length(chips.entering, 3) if chips.entering else "–",
                ),
            )
        )  # fmt: skip
    if not rows:
        return None
    low, high = (round(math.degrees(rake), 6) + 0.0 for rake in (min(rakes), max(rakes)))
    material = result.job.part.substance
    cautions = (material.caution(cut.chips.typical) for cut in result.passes if material and cut.chips)
    note = f"Effective rake angle: {low:.3g}° to {high:.3g}°."
    return _Chips(rows, " ".join([note, *(f"{one.capitalize()}." for one in dict.fromkeys(cautions) if one)]))


def _number(value: float) -> str:
    if math.isnan(value):
        return "–"
    if 1e4 <= abs(value) < 1e8:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.3g}"


def _numbers(predictions: Sequence[Prediction], passes: Sequence[Limits], verdicts: Sequence[Verdict]) -> list[_Number]:
    """Return the key figures: form error, roughness and cutting time."""
    numbers = []
    by_place = {(one.tolerance, one.place): one for one in verdicts}

    def number(label: str, value: float, key: tuple[str, str], note: str) -> _Number:
        one = by_place.get(key)
        if one is None:
            return _Number(label, _number(value), "nm", note)
        words = "; ".join([f"tolerance {_number(one.limit_nm)} nm, {note}", *filter(None, [one.reason])])
        return _Number(label, _number(value), "nm", words, ok=one.is_kept is not False)

    whole_parts = [one for one in predictions if one.error.polar]
    patches = [one for one in predictions if not one.error.polar]
    for one in whole_parts:
        numbers.append(number("Form error PV", one.pv_nm, ("form_pv", one.name), "highest minus lowest point"))
        if one.finish_nm is not None:
            numbers.append(number("Sq", one.finish_nm, ("sq", one.name), "of the roughest annulus"))
    if patches:
        worst = max(patches, key=lambda one: (bool(one.uncut), one.roughness.sq_nm))
        note = f"at “{worst.name}”" + (f", the roughest of {len(patches)} patches" if len(patches) > 1 else "")
        numbers.append(number("Sq", worst.roughness.sq_nm, ("sq", worst.name), note))
    last = passes[-1]
    note = f"{last.nearest} is nearest to its limit, {last.utilisation[last.nearest]:.0%}"
    if len(passes) > 1:
        note = f"of {len(passes)} passes, the last {_duration(last.cycle_time_s)}; {note}"
    value, unit = _duration(sum(limits.cycle_time_s for limits in passes)).split()
    numbers.append(_Number("Cutting time", value, unit, note))
    return numbers


def _failed(verdicts: Sequence[Verdict]) -> list[str]:
    """Return one sentence per missed tolerance."""
    return [one.sentence for one in verdicts if one.is_kept is False]


def _facts(part: Part, tool: Tool, actual: Tool, machine: Machine, real: Machine) -> dict[str, list[_Row]]:
    """Return the tables of part, tool and machine."""

    def angle(value: float | None) -> str:
        return "not stated" if value is None else f"{math.degrees(value):.4g}°"

    shown = [_Row("Nose radius", f"{tool.nose_radius:.6g} mm"), _Row("Included angle", angle(tool.included))]
    shown += [_Row("Rake", angle(tool.rake)), _Row("Clearance", angle(tool.clearance))]
    planned, real_edge = _deviations(tool), _deviations(actual)
    shown += [_Row(name, value) for name, value in planned.items() if value]
    shown += [
        _Row(f"{name}, simulated", value or "none") for name, value in real_edge.items() if value != planned[name]
    ]
    lathe = [_Row("Name", machine.name), _Row("Dialect", machine.dialect)]
    lathe += [_Row("Highest spindle speed", f"{machine.spindle_rpm:.4g} rev/min")]
    lathe += [_Row("Block rate", f"{machine.block_rate_hz:.4g} blocks/s")]
    if machine.squareness:
        lathe.append(_Row("Squareness", f"{machine.squareness * 1e6:.4g} µrad"))
    if real.squareness != machine.squareness:
        lathe.append(_Row("Squareness, simulated", f"{real.squareness * 1e6:.4g} µrad"))
    sheet = [_Row("Name", part.name or "–"), _Row("Surface", type(part.surface).__name__)]
    sheet += [_Row("Clear aperture, semi-diameter", f"{part.radius:.6g} mm"), _Row("Stock", _length(part.stock))]
    sheet += [_Row("Blank", f"disc, radius {part.blank.radius:.6g} mm" if part.blank else "not stated")]
    sheet += [_Row("Material", part.material_name or "not stated")]
    sheet += [_Row(name, _as_printed(value)) for name, value in part_shape(part).facts.items()]
    sheet += [_Row("Derived", remark) for remark in part.surface.remarks]
    if part.material_note:
        sheet.append(_Row("Material note", part.material_note))
    return {"Part": sheet, f"Tool {tool.name}".strip(): shown, "Machine": lathe}


def _deviations(tool: Tool) -> dict[str, str]:
    """Return the deviations of a cutting edge from the ideal one; empty strings where there is none."""
    waviness = float(np.abs(tool.deviation(np.linspace(*tool.arc, 721))).max())
    return {
        "Waviness": f"up to {_length(waviness)}" if waviness else "",
        "Radius error": _length(tool.radius_error) if tool.radius_error else "",
        "Tip offset x, y, z": ", ".join(_length(value) for value in tool.offset) if any(tool.offset) else "",
    }


def _access_rows(access: Access) -> list[_Row]:

    rows = []
    for finding in access.findings:
        lengths = finding.name in ("nose radius", "step")

        def shown(value: float | None, *, lengths: bool = lengths) -> str:
            if value is None:
                return "–"
            if math.isinf(value):
                return "any"
            return _length(value) if lengths else f"{math.degrees(value) + 0.0:.4g}°"

        where = "–" if finding.where is None else "{:.4g}, {:.4g}".format(*(round(at, 6) + 0.0 for at in finding.where))
        if finding.name == "rake":
            value = f"{math.degrees(access.rake_range[0]):.4g}° to {math.degrees(access.rake_range[1]):.4g}°"
        else:
            value = shown(finding.value)
        rows.append(_Row(finding.name, value, shown(finding.limit), shown(finding.margin), where, ok=finding.ok))
    return rows


def _spiral_rows(turns: Sequence[Motion], limits: Limits, feed: float) -> list[_Row]:
    """Return the table of the spiral of the finishing pass."""
    first, last = turns[0], turns[-1]
    inward = abs(first.axes["X"][0]) > abs(last.axes["X"][-1])
    counts = [(one.time.size - 1) * TURN / abs(float(one.axes["C"][-1] - one.axes["C"][0])) for one in turns]
    fewest, most = round(min(counts)), round(max(counts))
    return [
        _Row("Feed", f"{feed * 1e3:.4g} µm/rev"),
        _Row("Direction", "from the edge to the centre" if inward else "from the centre to the edge"),
        _Row("Azimuth under the tool", "increases" if first.sense > 0 else "decreases"),
        _Row("Starts and ends at X", f"{first.axes['X'][0]:.6g} and {last.axes['X'][-1] + 0.0:.6g} mm"),
        _Row("Points", f"{limits.points:,}"),
        _Row("Points per revolution", f"{fewest:,}" if most - fewest < 4 else f"{fewest:,} to {most:,}"),
    ]


def _limit_rows(limits: Limits, machine: Machine) -> list[_Row]:
    """Return the peak values with their limits and utilisation."""
    quantities: list[tuple[str, float, str, float | None, float]] = [
        ("block rate", limits.block_rate_hz, "blocks/s", machine.block_rate_hz, 1.0),
    ]
    letters = list(limits.peak_speed)
    for letter in letters:
        axis = machine.axes.get(letter)
        turning = letter in "ABC"
        kinds = (
            ("speed", limits.peak_speed, "rev/min" if turning else "mm/s", 60 / TURN if turning else 1.0),
            ("acceleration", limits.peak_acceleration, "rad/s²" if turning else "mm/s²", 1.0),
            ("jerk", limits.peak_jerk, "rad/s³" if turning else "mm/s³", 1.0),
        )
        for kind, peaks, unit, factor in kinds:
            stated = getattr(axis, kind, None)
            if letter == "C" and kind == "speed":
                quantities.append(("spindle speed", peaks[letter], unit, machine.spindle_rpm / factor, factor))
            else:
                quantities.append((f"{letter} {kind}", peaks[letter], unit, stated, factor))
        if letter in limits.frequency_hz and axis is not None:
            quantities.append((f"{letter} bandwidth", limits.frequency_hz[letter], "Hz", axis.bandwidth_hz, 1.0))
    rows = []
    for name, value, unit, limit, factor in quantities:
        share = limits.utilisation.get(name)
        rows.append(
            _Row(
                name, f"{_number(value * factor)} {unit}",
                "not stated" if limit is None else f"{_number(limit * factor)} {unit}",
                share=share, ok=share is None or share <= 1.001, binding=name == limits.nearest,
            )
        )  # fmt: skip
    for letter, (low, high) in limits.travel.items():
        if letter != "C":
            ends = " to ".join(f"{round(end, 9) + 0.0:.5g}" for end in (low, high))
            rows.append(_Row(f"{letter} travel", f"{ends} mm", _travel(machine, letter)))
    return rows


def _travel(machine: Machine, letter: str) -> str:
    axis = machine.axes.get(letter)
    if axis is None or (axis.low is None and axis.high is None):
        return "not stated"
    low, high = (("–" if end is None else f"{end:.5g}") for end in (axis.low, axis.high))
    return f"{low} to {high} mm"


def _maps(predictions: Sequence[Prediction], feed: float) -> tuple[list[_Map], int]:
    """Draw the first simulated maps; return them and the number of the others."""
    from turnwright.report import figures as draw  # noqa: PLC0415 - matplotlib is costly to import

    maps = []
    for one in predictions[:MAX_PICTURED_MAPS]:
        rough, size = one.roughness, one.error.z.shape
        note = f"{size[1]} radii × {size[0]} azimuths" if one.error.polar else f"{size[1]} × {size[0]} pixels"
        if one.error.x is not None:
            note += f" of {(one.error.x[1] - one.error.x[0]) * 1e3:.4g} µm"
        note += f" · PV {_number(one.pv_nm)} nm · Sq {_number(rough.sq_nm)} nm"
        note += " from the nominal surface" if rough.form == "none" else f" after form removal ({_form(rough.form)})"
        if one.error.radius is not None and (step := one.error.radius[1] - one.error.radius[0]) > feed / 4:
            note += f" · radial step {_length(float(step))} at a feed of {_length(feed)}/rev: cusps are aliased"
        cut = draw.rings(one.error) if one.error.polar else draw.profile(one.error, feed)
        servos = None
        if one.tracking is not None and one.tracking_nm is not None:
            pv, rms = one.tracking_nm
            sentence = f"Servo contribution: {_number(pv)} nm PV, {_number(rms)} nm rms, form included."
            servos = sentence, draw.error_map(one.tracking)
        maps.append(_Map(one.name, note, draw.error_map(one.error), cut, servos))
    return maps, max(len(predictions) - MAX_PICTURED_MAPS, 0)


def _form(form: str | int) -> str:
    return form if isinstance(form, str) else f"polynomial of degree {form}"


def _parameters(predictions: Sequence[Prediction]) -> list[tuple[str, str, list[str]]]:
    """Return the table of surface parameters: name, unit, one value per map."""
    names = [
        ("Sa", "nm", "sa_nm"),
        ("Sq", "nm", "sq_nm"),
        ("Sz (PV)", "nm", "sz_nm"),
        ("Ssk", "", "ssk"),
        ("Sku", "", "sku"),
    ]
    names += [("Sdq", "", "sdq"), ("Sdr", "%", "sdr")]
    table = [
        (name, unit, [_number(getattr(one.roughness, field)) for one in predictions]) for name, unit, field in names
    ]
    table.append(("Sal", "µm", [_number(one.roughness.sal * 1e3) for one in predictions]))
    is_bound = [any("upper bound" in note for note in one.roughness.notes) for one in predictions]
    ratios = [_number(one.roughness.str) for one in predictions]
    table.append(
        ("Str", "", [f"≤ {value}" if is_upper else value for value, is_upper in zip(ratios, is_bound, strict=True)])
    )
    if any(one.tracking_nm for one in predictions):
        parts = [one.tracking_nm or (math.nan, math.nan) for one in predictions]
        table.append(("Servo contribution, PV", "nm", [_number(pv) for pv, _ in parts]))
        table.append(("Servo contribution, rms", "nm", [_number(rms) for _, rms in parts]))
    table.append(("Form removed", "", [_form(one.roughness.form) for one in predictions]))
    table.append(("Heights counted", "", [f"{one.roughness.valid:,}" for one in predictions]))
    table.append(("Not cut", "", [f"{one.uncut:,}" for one in predictions]))
    return table


def _parameter_notes(predictions: Sequence[Prediction]) -> list[str]:
    return [f"{one.name}: {note}." for one in predictions for note in one.roughness.notes]


def _timings(timings: Mapping[str, float]) -> list[_Row]:
    total = sum(timings.values())
    rows = [_Row(name, f"{value:.2f} s", share=value / total if total else 0.0) for name, value in timings.items()]
    return [*rows, _Row("total", f"{total:.1f} s")]


def _link(file: File, page: File) -> _Link:
    is_adjacent = file.is_file() and file.resolve().parent == page.resolve().parent
    return _Link(file.name, file.name if is_adjacent else None)


def _head(file: File) -> str:
    """Return the first lines of a program; empty if the file does not exist."""
    if not file.is_file():
        return ""
    with file.open(encoding="utf-8", errors="replace") as lines:
        return "".join(line[:200] for line, _ in zip(lines, range(LISTED_LINES), strict=False))


def _thinned(motion: Motion) -> Motion:
    few = slice(None, None, max(1, math.ceil(motion.time.size / MAX_PICTURE_POINTS)))
    axes = {letter: values[few] for letter, values in motion.axes.items()}
    return Motion(time=motion.time[few], axes=axes, machine=motion.machine)


def _single_turns(motion: Motion) -> tuple[Motion, ...]:
    """Return the first revolution, one halfway and the last."""
    angle = np.abs(motion.axes["C"] - motion.axes["C"][0])
    last = max(float(angle[-1]) - TURN, 0.0)
    turns = []
    for start in (0.0, last / 2, last):
        first, stop = np.searchsorted(angle, (start, start + TURN * (1 + 1e-9)))
        span = slice(max(int(first) - 1, 0), int(stop) + 1)
        axes = {letter: values[span] for letter, values in motion.axes.items()}
        turns.append(Motion(time=motion.time[span], axes=axes, machine=motion.machine))
    return tuple(turns)
