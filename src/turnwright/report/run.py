"""Pages of a run and of a back-plotted NC program."""

from __future__ import annotations

import math
from pathlib import Path as File
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.chuck import Chuck
from turnwright.job import judge, part_shape
from turnwright.path import Motion
from turnwright.post import dialect_of, stop_instructions
from turnwright.report import figures
from turnwright.report.drawing import draw
from turnwright.report.optics import optics_section
from turnwright.report.page import Cell, Code, Drawing, Number, Page, Section, Table, page_file, write_page
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from os import PathLike

    from turnwright.access import Access, AccessFinding
    from turnwright.job import Entry, Job, Pass, Prediction, Result, Verdict
    from turnwright.machine import Machine
    from turnwright.metrology import Roughness
    from turnwright.motion import Limits
    from turnwright.outline import Outline
    from turnwright.part import Part
    from turnwright.tool import Tool

__all__ = ["compose_report", "draw_ahead", "roughness_rows", "write_backplot", "write_report"]

NM = 1e6
TURN = 2 * math.pi

MAX_PICTURED_MAPS = 6
"""Maps shown as pictures; the page states how many more there are."""

LISTED_LINES = 40
"""Program lines shown on the page."""

MAX_PICTURE_POINTS = 20_000
"""Points of a motion drawn in a picture."""

LIMIT_COLUMNS = ("Quantity", "Peak", "Limit", "Used", "")

ACCESS_TEXT = (
    "For the nose radius, the value is the tool's and the limit is the part's; for angles, the value is what the part "
    "needs and the limit is what the tool has. The point of the smallest margin is marked on the map by its number."
)

APPROACH_TEXT = (
    "With the part at rest, the tool comes no closer than 0.1 mm to the material. Where a pass cannot begin clear of "
    "the material, the tool plunges with the part rotating."
)

CHIP_TEXT = (
    "Cutting is brittle above the critical chip thickness; cracks are harmless where later passes remove more than "
    "their depth. The first revolution and points outside the clear aperture have thicker chips, as no previous "
    "revolution limits them."
)


def write_report(result: Result, path: str | PathLike[str]) -> File:
    """Write the page of a run, see `write_page`."""
    return write_page(compose_report(result, path), path)


def draw_ahead(job: Job) -> Callable[[str, Any], None]:
    """Order the figures of the part of a job; return what orders those of the fields of its result, see `job.run`."""
    _part_figures(job)
    computed: Any = SimpleNamespace(part=job.part, tool=job.tool)
    of_field: dict[str, Callable[[Any], list[Drawing]]] = {
        "access": _access_figures,
        "chips": _chip_figures,
        "revolutions": lambda computed: [*_path_figures(computed), *_axes_figures(computed)],
        "entries": _approach_figures,
        "predictions": lambda computed: [
            one
            for prediction in computed.predictions[:MAX_PICTURED_MAPS]
            for one in _map_figures(prediction, computed.passes[-1].feed, job.part.border)
        ],
    }

    def order(field: str, value: Any) -> None:
        setattr(computed, field, value)
        if field in of_field:
            of_field[field](computed)

    return order


def _part_figures(job: Job) -> list[Drawing]:
    return [draw(figures.sag_map, job.part), draw(figures.view, job.part)]


def _access_figures(result: Result) -> list[Drawing]:
    return [draw(figures.access_map, result.part, result.access.findings)]


def _path_figures(result: Result) -> list[Drawing]:
    turns = result.revolutions
    return [
        draw(figures.spiral, result.motion, turns[len(turns) // 2], result.passes[-1].feed, result.part.border),
        draw(figures.contact, result.path),
    ]


def _axes_figures(result: Result) -> list[Drawing]:
    return [draw(figures.z_over_turns, result.revolutions), draw(figures.axes_over_time, result.motion)]


def _approach_figures(result: Result) -> list[Drawing]:
    entries, tool = result.entries, result.tool
    return [draw(figures.approach_view, name, entries[name], tool) for name in _ends(result)]


def _chip_figures(result: Result) -> list[Drawing]:
    chips, part = result.chips, result.part
    return [draw(figures.chip_map, name, part, chips[name], part.substance) for name in _ends(result) if name in chips]


def _ends(result: Result) -> list[str]:
    """Return the names of the first and the last pass."""
    return list(dict.fromkeys((result.passes[0].name, result.passes[-1].name)))


def _map_figures(one: Prediction, feed: float, border: Outline) -> list[Drawing]:
    across = draw(figures.rings, one.error) if one.error.polar else draw(figures.profile, one.error, feed)
    drawings = [draw(figures.error_map, one.error, border=border), across]
    if one.tracking is not None:
        drawings.append(
            draw(figures.error_map, one.tracking, "Change of the surface by the servo response", border=border)
        )
    return drawings


def compose_report(result: Result, path: str | PathLike[str]) -> Page:
    """Return the page of a run for a file, and order its figures."""
    path = page_file(path)
    verdicts, program, feed = result.verdicts, result.program, result.passes[-1].feed
    failed = _missed_sentences(verdicts)
    is_rounded = result.rounding_nm > result.rounding_limit_nm
    if is_rounded:
        failed.append("rounding in the program exceeds its limit")
    if failed:
        grade, word, why = "bad", "Not ready", "; ".join(failed)
    elif brittle := [cut.name for cut in result.passes if cut.chips is not None and not cut.chips.ok]:
        grade, word, why = "warn", "Brittle fracture possible", f"not in the ductile regime: {', '.join(brittle)}"
    elif not result.ok:
        grade, word, why = "warn", "Ready with exceptions", "exceeds a limit that the job accepts"
    else:
        unevaluated = [one.sentence for one in verdicts if one.is_kept is None]
        met = "tool access, machine limits and tolerances met"
        if len(unevaluated) == len(verdicts):
            met = "tool access and machine limits met"
        grade, word, why = "warn" if unevaluated else "good", "Ready to cut", "; ".join([met, *unevaluated])
    count = len(result.warnings)
    return Page(
        kind="Run",
        job=result.job,
        grade=grade,
        word=word,
        why=[why, f"{count or 'no'} {'warning' if count == 1 else 'warnings'}"],
        numbers=_numbers(result.predictions, [cut.limits for cut in result.passes], verdicts),
        notes=result.warnings,
        sections=[
            _things(result.job),
            _setup(result),
            Section(
                title="Access",
                items=[
                    _access_table(result.access, result.findings),
                    *_access_figures(result),
                ],
            ),
            Section(
                title="Path",
                items=[
                    *_path_figures(result),
                    _spiral_table(
                        result.revolutions,
                        result.limits,
                        feed,
                        ["Nose compensation along", "surface normal" if result.job.strategy.along == "normal" else "z"],
                        [
                            "Minimum clearance of the cutting edge",
                            f"{result.least_clearance * NM + 0.0:.3g} nm (0 is contact, negative is a gouge)",
                        ],
                    ),
                ],
            ),
            _approach(result),
            Section(
                title="Axes and limits",
                items=[
                    *_axes_figures(result),
                    *(
                        _limit_table(cut.name, _pass_facts(cut), cut.limits, result.machine, folded=number > 0)
                        for number, cut in enumerate(reversed(result.passes))
                    ),
                ],
            ),
            *_chips(result),
            *_surfaces(result.predictions, feed, result.job.part.border),
            *([] if result.optics is None else [optics_section(result.optics)]),
            _program(
                program.files,
                path,
                ["Dialect", result.machine.dialect],
                ["Lines", f"{program.lines:,}"],
                ["Size", f"{program.bytes / 1e6:.3g} MB"],
                ["Cutting time", _duration(program.minutes * 60)],
                ["Approaches, plunges and retracts", _duration(program.links_minutes * 60)],
                ["SHA-256", Cell(program.hash, "code")],
                [
                    "Surface change by rounding in the program",
                    Cell(
                        f"{result.rounding_nm:.3g} nm, limit {result.rounding_limit_nm:.3g} nm",
                        "no" if is_rounded else "yes",
                    ),
                ],
            ),
            Section(title="Run", items=[_timings(result)]),
        ],
    )


def write_backplot(
    program: str | PathLike[str],
    job: Job,
    motion: Motion,
    limits: Limits,
    predictions: Sequence[Prediction],
    path: str | PathLike[str],
) -> File:
    """Write the page of a back-plotted NC program, see `write_page`.

    The job has the nominal surface, tool and machine of the simulation.
    """
    path, program = page_file(path), File(program)
    verdicts = judge(job, predictions)
    failed = _missed_sentences(verdicts)
    if not limits.ok:
        failed.append("a machine limit is exceeded")
    turns, feed = motion.sample_revolutions(), motion.feed
    shown = motion.select(slice(None, None, max(1, math.ceil(motion.time.size / MAX_PICTURE_POINTS))))
    facts = f"{limits.spindle_rpm:.4g} rev/min · {limits.points:,} points · {_duration(limits.cycle_time_s)}"
    page = Page(
        title=job.part.name or program.name,
        kind=f"Back-plot of {program.name}",
        job=job,
        grade="bad" if failed else "good",
        word="Exceeds a limit" if failed else "Within limits",
        why=["; ".join(failed)],
        numbers=_numbers(predictions, [limits], verdicts),
        notes=[*limits.findings, *(sentence for one in predictions for sentence in one.remarks)],
        sections=[
            _things(job),
            Section(
                title="Path",
                items=[
                    draw(figures.spiral, shown, turns[len(turns) // 2], feed, job.part.border),
                    _spiral_table(turns, limits, feed),
                ],
            ),
            Section(
                title="Axes and limits",
                items=[
                    draw(figures.z_over_turns, turns),
                    draw(figures.axes_over_time, shown),
                    _limit_table(program.name, facts, limits, job.machine),
                ],
            ),
            *_surfaces(predictions, feed, job.part.border),
            _program(
                [program],
                path,
                *([["Size", f"{program.stat().st_size / 1e6:.3g} MB"]] if program.is_file() else []),
            ),
        ],
    )
    return write_page(page, path)


def _pass_facts(cut: Pass) -> str:
    depth = [f"depth {_length(cut.depth)}, allowance {_length(cut.allowance)}"] if cut.depth else []
    speed = [f"{cut.feed * 1e3:.4g} µm/rev", f"{cut.spindle_rpm:.4g} rev/min"]
    return " · ".join([*depth, *speed, f"{cut.points:,} points", _duration(cut.limits.cycle_time_s)])


def _approach(result: Result) -> Section:
    """Return the section of the approaches: side views of the first and last pass, and a table of all."""
    columns = ("Pass", "Depth at the first point", "Entry", "Plunge feed", "Revolutions", "Time",
               "Minimum gap, part at rest")  # fmt: skip
    return Section(
        title="Approach",
        items=[
            *_approach_figures(result),
            Table(
                columns=columns,
                numeric=(1, 3, 4, 5, 6),
                rows=[(name, *_approach_facts(entry)) for name, entry in result.entries.items()],
                notes=[APPROACH_TEXT],
                dense=True,
            ),
        ],
    )


def _approach_facts(entry: Entry) -> tuple[str, ...]:
    """Return the row of an approach: depth, entry, plunge feed, revolutions, time and minimum gap."""
    approach = entry.approach
    if approach.plunge is None:
        return ("none", "clear of the material", "–", "–", "–", _length(entry.least_gap))
    return (
        _length(max(entry.depth or 0.0, 0.0)),
        "plunge with the part rotating",
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


def _chips(result: Result) -> list[Section]:
    """Return the section of the uncut chip thickness with the ductile-mode check of each pass, if it is known."""
    rows: list[tuple[str | Cell, ...]] = []
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
        verdict = chips.verdict if chips.ok == ductile else f"{chips.verdict}, {exception}"
        values = (
            _length(chips.thickest, 3), limit, margin, _length(chips.typical, 3), feed,
            "–" if chips.fracture is None else "none" if not chips.fracture else _length(chips.fracture, 3),
            _length(cut.allowance, 3) if cut.allowance else "none",
            force,
            _length(chips.entering, 3) if chips.entering else "–",
        )  # fmt: skip
        grade = "no" if not chips.ok else "yes" if ductile else "soft"
        rows.append((cut.name, Cell(verdict, grade), *(value.replace(" ", "\u00a0") for value in values)))
    if not rows:
        return []
    low, high = (round(math.degrees(rake), 6) + 0.0 for rake in (min(rakes), max(rakes)))
    material = result.job.part.substance
    cautions = (material.caution(cut.chips.typical) for cut in result.passes if material and cut.chips)
    note = [CHIP_TEXT, f"Effective rake angle: {low:.3g}° to {high:.3g}°."]
    note += [f"{one.capitalize()}." for one in dict.fromkeys(cautions) if one]
    columns = (
        "Pass", "Verdict", "Maximum", "Critical there", "Margin", "Typical", "Ductile up to", "Crack depth",
        "Removed by later passes", "Force, axial / cutting", "On entry",
    )  # fmt: skip
    table = Table(columns=columns, numeric=range(2, 11), rows=rows, notes=[" ".join(note)], dense=True)
    return [Section(title="Uncut chip thickness", items=[*_chip_figures(result), table])]


def _number(value: float) -> str:
    if math.isnan(value):
        return "–"
    if 1e4 <= abs(value) < 1e8:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.3g}"


def _numbers(predictions: Sequence[Prediction], passes: Sequence[Limits], verdicts: Sequence[Verdict]) -> list[Number]:
    """Return the key figures: form error, roughness and cutting time."""
    numbers = []
    by_place = {(one.tolerance, one.place): one for one in verdicts}

    def number(label: str, value: float, key: tuple[str, str], note: str) -> Number:
        one = by_place.get(key)
        if one is None:
            return Number(label, _number(value), "nm", note)
        words = "; ".join([f"tolerance {_number(one.limit)} nm, {note}", *filter(None, [one.reason])])
        return Number(label, _number(value), "nm", words, ok=one.is_kept is not False)

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
    numbers.append(Number("Cutting time", value, unit, note))
    return numbers


def _aperture(part: Part) -> dict[str, str]:
    """Return the clear aperture in words."""
    if part.outline is None:
        return {"Clear aperture, semi-diameter": f"{part.reach:.6g} mm"}
    reach = f"{part.nearest:.6g} to {part.reach:.6g} mm from the axis"
    air = {"Clearance in air": _length(part.air_clearance)} if part.leaves_air else {}
    if isinstance(part.surface, Chuck):
        return {"Clear aperture": f"{len(part.surface.parts)} parts, see set-up; {reach}", **air}
    return {"Clear aperture": f"{part.outline.words}; {reach}", **air}


def _blank(part: Part) -> str:
    if part.blank is None:
        return "not stated"
    top = "" if part.blank.surface is None else f", top: {type(part.blank.surface).__name__}"
    return f"disc, radius {part.blank.radius:.6g} mm{top}"


def _missed_sentences(verdicts: Sequence[Verdict]) -> list[str]:
    """Return one sentence per missed tolerance."""
    return [one.sentence for one in verdicts if one.is_kept is False]


def _things(job: Job) -> Section:
    """Return the section of part, tool and machine."""
    part, tool, machine = job.part, job.tool, job.machine

    def angle(value: float | None) -> str:
        return "not stated" if value is None else f"{math.degrees(value):.4g}°"

    about_part = {
        "Name": part.name or "–",
        "Surface": type(part.surface).__name__,
        **_aperture(part),
        "Stock": _length(part.stock),
        "Blank": _blank(part),
        "Material": part.material_name or "not stated",
        **{name: _as_printed(value) for name, value in part_shape(part).facts.items()},
    }
    about_tool = {
        "Nose radius": f"{tool.nose_radius:.6g} mm",
        "Included angle": angle(tool.included),
        "Rake": angle(tool.rake),
        "Clearance": angle(tool.clearance),
    }
    about_tool |= {
        name.capitalize(): f"radius {one.radius:.4g} mm, from {one.height:.4g} mm above the tip"
        for name, one in tool.bodies.items()
    }
    planned = _deviations(tool)
    about_tool |= {name: value for name, value in planned.items() if value}
    for name, value in _deviations(job.actual_tool).items():
        if value != planned[name]:
            about_tool[f"{name}, simulated"] = value or "none"
    about_machine = {
        "Name": machine.name,
        "Dialect": machine.dialect,
        "Highest spindle speed": f"{machine.spindle_rpm:.4g} rev/min",
        "Block rate": f"{machine.block_rate_hz:.4g} blocks/s",
    }
    if machine.spindle_mode_rpm is not None:
        about_machine["Highest speed in spindle mode"] = f"{machine.spindle_mode_rpm:.4g} rev/min"
    if machine.squareness:
        about_machine["Squareness"] = f"{machine.squareness * 1e6:.4g} µrad"
    if job.actual_machine.squareness != machine.squareness:
        about_machine["Squareness, simulated"] = f"{job.actual_machine.squareness * 1e6:.4g} µrad"
    remarks = [("Derived", remark) for remark in part.surface.remarks]
    if part.material_note:
        remarks.append(("Material note", part.material_note))
    return Section(
        title="Part, tool, machine",
        items=[
            *_part_figures(job),
            Table(title="Part", rows=[*about_part.items(), *remarks], span=2),
            Table(title=f"Tool {tool.name}".strip(), rows=list(about_tool.items()), span=2),
            Table(title="Machine", rows=list(about_machine.items()), span=2),
        ],
    )


def _setup(result: Result) -> Section:
    """Return the set-up sheet: zeros, directions, what to do after a stop, and the places of parts on a chuck."""
    job, start = result.job, result.job.program.start
    convention = result.machine.convention
    surface = job.part.surface
    frame = "chuck" if isinstance(surface, Chuck) else "part"
    rows = [
        ("Work offset", start.work_offset or "the one that is active"),
        ("Tool call", job.passes[0].tool_call or start.tool_call or "the tool that is active"),
        ("X0", "tool tip on the spindle axis"),
        ("Z0", "tool tip at the height of the origin of the " + frame),
        ("C under the tool at the +x direction of the " + frame, f"{math.degrees(convention.clocking):.4g}°"),
        ("X away from the axis", "grows" if convention.x_side > 0 else "falls"),
        ("Z away from the part", "grows" if convention.z_sign > 0 else "falls"),
    ]
    items = [Table(title="Zeros and directions", rows=rows, span=2), _stops(result)]
    if any(cut.tool is not None for cut in job.passes):
        items.append(_tools(job))
    if isinstance(surface, Chuck):
        items.append(
            Table(
                title="Parts on the chuck",
                columns=("Part", "Surface", "x [mm]", "y [mm]", "Height [mm]", "Clocking", "From the axis [mm]", "At"),
                numeric=range(2, 8),
                rows=[
                    [
                        one.name, type(one.surface).__name__, *(f"{at + 0.0:.4f}" for at in one.position),
                        f"{one.height + 0.0:.4f}", f"{math.degrees(one.clocking):.4g}°",
                        f"{math.hypot(*one.position):.4f}",
                        f"{math.degrees(math.atan2(one.position[1], one.position[0])) + 0.0:.4g}°",
                    ]
                    for one in surface.parts
                ],
                notes=["Positions of the origin of each part in the frame of the chuck, seen from the tool."],
                span=4,
            )
        )  # fmt: skip
    return Section(title="Set-up", items=items)


def _stops(result: Result) -> Table:
    """Return the table of the order of the axes, and of what to do when the program is stopped."""
    spindle = [one.limits.spindle_mode for one in result.passes]
    holds = {
        False: "Feed hold stops C with the tool on the part. It leaves a mark: retract in Z before you go on",
        True: "Feed hold stops X and Z while the part turns. The tool leaves a ring: retract in Z before you go on",
    }
    order = {
        False: "Z up to the clear plane, X, C, then Z down",
        True: "Z up to the clear plane, X, spindle, then Z down",
    }
    kinds = [kind for kind in (True, False) if kind in spindle]
    names = {True: "in spindle mode", False: "with C as an axis"} if len(kinds) > 1 else dict.fromkeys(kinds, "")
    instructions = stop_instructions(dialect_of(result.machine), has_c=not all(spindle))
    rows = [
        *((f"Approach {names[kind]}".strip(), order[kind]) for kind in kinds),
        ("Retract", "Z alone, to the clear plane"),
        *((f"Feed hold {names[kind]}".strip(), f"{holds[kind]}.") for kind in kinds),
        ("Restart in the middle", ". ".join(instructions) + "."),
    ]
    return Table(title="Moves and stops", rows=rows, span=2)


def _tools(job: Job) -> Table:
    """Return the table of the tools in the order of the passes."""
    rows = []
    for cut in job.passes:
        tool = job.tool_of(cut)
        rows.append(
            (
                cut.name, tool.name or "–", cut.tool_call or job.program.tool_call, f"{tool.nose_radius:.4g}",
                "–" if tool.included is None else f"{math.degrees(tool.included):.4g}°",
                *("–" if one is None else f"{one.radius:.4g}, {one.height:.4g}" for one in (tool.shank, tool.holder)),
                _length(cut.allowance),
            )
        )  # fmt: skip
    height = job.program.change_height or 0.0
    return Table(
        title="Tools",
        columns=(
            "Pass",
            "Tool",
            "Tool call",
            "Nose radius [mm]",
            "Included angle",
            "Shank: radius, height [mm]",
            "Holder: radius, height [mm]",
            "Leaves",
        ),
        numeric=range(3, 8),
        rows=rows,
        notes=[f"A tool is changed {height:.4g} mm above the clear plane of the passes."],
        span=4,
    )


def _deviations(tool: Tool) -> dict[str, str]:
    """Return the deviations of a cutting edge from the ideal one; empty strings where there is none."""
    waviness = float(np.abs(tool.deviation(np.linspace(*tool.arc, 721))).max())
    return {
        "Waviness": f"up to {_length(waviness)}" if waviness else "",
        "Radius error": _length(tool.radius_error) if tool.radius_error else "",
        "Tip offset x, y, z": ", ".join(_length(value) for value in tool.offset) if any(tool.offset) else "",
    }


def _access_table(access: Access, findings: Sequence[AccessFinding]) -> Table:
    rows = []
    for number, finding in enumerate(findings):
        is_length = finding.name in ("nose radius", "step", "shank", "holder")

        def shown(value: float | None, *, is_length: bool = is_length) -> str:
            if value is None:
                return "–"
            if math.isinf(value):
                return "any"
            return _length(value) if is_length else f"{math.degrees(value) + 0.0:.4g}°"

        where = "–" if finding.where is None else "{:.4g}, {:.4g}".format(*(round(at, 6) + 0.0 for at in finding.where))
        value = shown(finding.value)
        if finding.name == "rake":
            is_own = number < len(access.findings)
            value = (
                " to ".join(f"{math.degrees(end):.4g}°" for end in access.rake_range)
                if is_own
                else shown(finding.value)
            )
        verdict = Cell("ok", "yes") if finding.ok else Cell("not ok", "no")
        name = (
            finding.name if number < len(access.findings) else f"{finding.name}, {finding.sentence.partition(':')[0]}"
        )
        rows.append((name, value, shown(finding.limit), shown(finding.margin), where, verdict))
    return Table(
        columns=("Quantity", "Value", "Limit", "Margin", "Where x, y [mm]", "Verdict"),
        numeric=range(1, 5),
        rows=rows,
        notes=[ACCESS_TEXT],
        numbered=True,
        span=4,
    )


def _spiral_table(turns: Sequence[Motion], limits: Limits, feed: float, *more: Sequence[str]) -> Table:
    """Return the table of the spiral of the finishing pass."""
    first, last = turns[0], turns[-1]
    inward = abs(first.axes["X"][0]) > abs(last.axes["X"][-1])
    counts = [(one.time.size - 1) * TURN / abs(float(one.axes["C"][-1] - one.axes["C"][0])) for one in turns]
    fewest, most = round(min(counts)), round(max(counts))
    rows = [
        ("Feed", f"{feed * 1e3:.4g} µm/rev"),
        ("Direction", "from the edge to the centre" if inward else "from the centre to the edge"),
        ("Azimuth under the tool", "increases" if first.sense > 0 else "decreases"),
        ("Starts and ends at X", f"{first.axes['X'][0]:.6g} and {last.axes['X'][-1] + 0.0:.6g} mm"),
        ("Points", f"{limits.points:,}"),
        ("Points per revolution", f"{fewest:,}" if most - fewest < 4 else f"{fewest:,} to {most:,}")
        if first.spindle_mode is None
        else ("Spindle", f"in spindle mode, {'M04' if first.sense > 0 else 'M03'}"),
    ]
    return Table(rows=[*rows, *more], span=3)


def _limit_table(title: str, facts: str, limits: Limits, machine: Machine, *, folded: bool = False) -> Table:
    """Return the peak values with their limits and utilisation."""
    machine = machine.in_spindle_mode() if limits.spindle_mode else machine
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
            if limits.spindle_mode and letter == "C" and kind != "speed":
                continue
            if letter == "C" and kind == "speed":
                quantities.append(("spindle speed", peaks[letter], unit, machine.spindle_rpm / factor, factor))
            else:
                quantities.append((f"{letter} {kind}", peaks[letter], unit, stated, factor))
        if letter in limits.frequency_hz and axis is not None:
            quantities.append((f"{letter} bandwidth", limits.frequency_hz[letter], "Hz", axis.bandwidth_hz, 1.0))
    rows: list[Sequence[str | Cell]] = []
    for name, value, unit, limit, factor in quantities:
        share = limits.utilisation.get(name)
        used: tuple[str | Cell, ...] = ("", "")
        if share is not None:
            nearest, is_over = name == limits.nearest, share > 1.001
            percent = f"{100 * share:.3g} %" if share >= 1e-4 else "< 0.01 %"
            used = (
                Cell(share=share, bar="over" if is_over else "binds" if nearest else ""),
                Cell(percent + (" · nearest" if nearest else ""), "no" if is_over else ""),
            )
        stated = "not stated" if limit is None else f"{_number(limit * factor)} {unit}"
        rows.append((name, f"{_number(value * factor)} {unit}", stated, *used))
    for letter, (low, high) in limits.travel.items():
        if letter != "C":
            ends = " to ".join(f"{round(end, 9) + 0.0:.5g}" for end in (low, high))
            rows.append((f"{letter} travel", f"{ends} mm", _travel(machine, letter), "", ""))
    return Table(title=title, text=facts, columns=LIMIT_COLUMNS, numeric=(1, 2, 4), rows=rows, folded=folded)


def _travel(machine: Machine, letter: str) -> str:
    axis = machine.axes.get(letter)
    if axis is None or (axis.low is None and axis.high is None):
        return "not stated"
    low, high = (("–" if end is None else f"{end:.5g}") for end in (axis.low, axis.high))
    return f"{low} to {high} mm"


def _surfaces(predictions: Sequence[Prediction], feed: float, border: Outline) -> list[Section]:
    """Return the sections of the simulated surfaces: pictures of the first maps, and the parameters of all."""
    count = max(len(predictions) - MAX_PICTURED_MAPS, 0)
    more = f"{count} more {'map is' if count == 1 else 'maps are'} in the run folder and in the table."
    return [
        Section(title="Simulated surface of the program", text=[more] if count else []),
        *(_surface(one, feed, border) for one in predictions[:MAX_PICTURED_MAPS]),
        Section(
            title="Surface parameters",
            source="ISO 25178-2",
            items=[
                Table(
                    columns=("Parameter", *(one.name for one in predictions)),
                    numeric=range(1, len(predictions) + 1),
                    rows=_parameters(predictions),
                    notes=[f"{one.name}: {note}." for one in predictions for note in one.roughness.notes],
                )
            ],
        ),
    ]


def _surface(one: Prediction, feed: float, border: Outline) -> Section:
    """Return the subsection of a simulated map."""
    rough, size, x, radius = one.roughness, one.error.z.shape, one.error.x, one.error.radius
    note = f"{size[1]} radii × {size[0]} azimuths" if one.error.polar else f"{size[1]} × {size[0]} pixels"
    if x is not None:
        note += f" of {(x[1] - x[0]) * 1e3:.4g} µm"
    note += f" · PV {_number(one.pv_nm)} nm · Sq {_number(rough.sq_nm)} nm"
    note += " from the nominal surface" if rough.form == "none" else f" after form removal ({_form(rough.form)})"
    if radius is not None and (step := radius[1] - radius[0]) > feed / 4:
        note += f" · radial step {_length(float(step))} at a feed of {_length(feed)}/rev: cusps are aliased"
    text = [note]
    if one.tracking_nm is not None:
        pv, rms = one.tracking_nm
        text.append(f"Servo contribution: {_number(pv)} nm PV, {_number(rms)} nm rms, form included.")
    return Section(title=one.name, text=text, items=_map_figures(one, feed, border), is_subsection=True)


def _form(form: str | int) -> str:
    return form if isinstance(form, str) else f"polynomial of degree {form}"


def _parameters(predictions: Sequence[Prediction]) -> list[list[str]]:
    """Return the table of surface parameters, one column per map."""
    rows = roughness_rows([one.roughness for one in predictions])
    if any(one.tracking_nm for one in predictions):
        for index, kind in enumerate(("PV", "rms")):
            sizes = [one.tracking_nm[index] if one.tracking_nm else math.nan for one in predictions]
            rows.append([f"Servo contribution, {kind} [nm]", *map(_number, sizes)])
    return [*rows, ["Not cut", *(f"{one.uncut:,}" for one in predictions)]]


def roughness_rows(maps: Sequence[Roughness]) -> list[list[str]]:
    """Return the rows of a table of surface parameters, one column per map."""
    fields = {
        "Sa [nm]": "sa_nm", "Sq [nm]": "sq_nm", "Sp [nm]": "sp_nm", "Sv [nm]": "sv_nm", "Sz (PV) [nm]": "sz_nm",
        "Ssk": "ssk", "Sku": "sku", "Sdq": "sdq", "Sdr [%]": "sdr",
    }  # fmt: skip
    rows = [[name, *(_number(getattr(one, key)) for one in maps)] for name, key in fields.items()]
    rows.append(["Sal [µm]", *(_number(one.sal * 1e3) for one in maps)])
    bounds = ["≤ " if any("upper bound" in note for note in one.notes) else "" for one in maps]
    rows.append(["Str", *(f"{bound}{_number(one.str)}" for bound, one in zip(bounds, maps, strict=True))])
    rows.append(["Form removed", *(_form(one.form) for one in maps)])
    rows.append(["Heights counted", *(f"{one.valid:,}" for one in maps)])
    return rows


def _timings(result: Result) -> Table:
    total = sum(result.timings.values())
    rows: list[Sequence[str | Cell]] = [
        (name, f"{value:.2f} s", Cell(share=value / total if total else 0.0)) for name, value in result.timings.items()
    ]
    memory = f"{result.peak_memory_gb:.2f} GB" if math.isfinite(result.peak_memory_gb) else "unknown"
    rows += [("total", f"{total:.1f} s", ""), ("peak memory", memory, "")]
    return Table(columns=("Stage", "Wall time", "Share"), numeric=(1,), rows=rows)


def _program(files: Sequence[File], page: File, *rows: Sequence[str | Cell]) -> Section:
    """Return the section of a program; files in the folder of the page are linked."""
    links = [("File", _link(file, page)) for file in files]
    head = _head(files[0]) if files else ""
    code = [Code(f"First lines of {files[0].name}", head)] if head else []
    return Section(title="Program", items=[Table(rows=[*rows, *links], span=3), *code])


def _link(file: File, page: File) -> Cell:
    is_adjacent = file.is_file() and file.resolve().parent == page.resolve().parent
    return Cell(file.name, address=file.name if is_adjacent else "")


def _head(file: File) -> str:
    """Return the first lines of a program; empty if the file does not exist."""
    if not file.is_file():
        return ""
    with file.open(encoding="utf-8", errors="replace") as lines:
        return "".join(line[:200] for line, _ in zip(lines, range(LISTED_LINES), strict=False))
