"""Simulate one draw of an error budget: the part cut as planned, and corrected by test parts measured before it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from turnwright.diagnosis import DEFAULT, FREE, diagnose, prove
from turnwright.heightmap import HeightMap
from turnwright.job import Job, make_test_part
from turnwright.metrology import remove_form
from turnwright.optics import path_per_height
from turnwright.studies.budget import ErrorBudget
from turnwright.studies.files import fetch_array, list_files, provide_files, relocate_paths, store_files
from turnwright.studies.scenes import (
    ContactShift,
    CutSurface,
    PlannedMotion,
    Scene,
    add_drift,
    drift_share,
    make_lines,
    make_scenes,
    pack_motion,
    plan_motion,
    scene_motion,
    select_points,
    servos_respond,
)  # fmt: skip
from turnwright.surface import Zernike
from turnwright.tool import WavinessTable

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.diagnosis import Diagnosis
    from turnwright.machine import Machine
    from turnwright.progress import Progress
    from turnwright.studies.cases import Row
    from turnwright.studies.store import Store
    from turnwright.tool import Tool

__all__ = [
    "ActualSetup",
    "CaseContext",
    "apply_draw",
    "bound_shift",
    "carry_out",
    "form_error",
    "plan_cuts",
    "residual_setup",
]

NM = 1e6

EDGE_POINTS = 721
"""Sweep angles at which the residual waviness of an edge is tabulated."""

MIN_SLOPE = 1e-6
"""Slopes below this count as zero: a lateral shift of such a surface changes nothing."""

RANK_TOL = 1e-9
"""Relative singular value below which rigid motions of a surface are not distinguished."""

_benches: dict[str, CaseContext] = {}
"""Context of the study that this process last worked on."""


class ActualSetup(NamedTuple):
    """The actual tool, machine and mount of a cut."""

    tool: Tool
    machine: Machine
    faster: Mapping[str, float]  # relative deviation of the natural frequency of each axis
    drift: tuple[float, float]  # along X and Z at the end of the cut [mm]
    mounting: Mapping[int, float]  # fringe terms [mm]
    tilt: tuple[float, float]  # of the part in the chuck, about x and y [rad]


def apply_draw(tool: Tool, machine: Machine, draw: Mapping[str, float], cut: str = "") -> ActualSetup:
    """Return the actual set-up with the errors of a draw [mm, rad], in the cut of a test part or of the part."""

    def one(name: str, *, per_cut: bool = False) -> float:
        return draw.get(f"{cut}: {name}" if per_cut and cut else name, 0.0)

    def terms(of: str) -> dict[int, float]:
        head = f"{cut}: {of} Z" if cut else f"{of} Z"
        return {int(name[len(head) :]): value for name, value in draw.items() if name.startswith(head)}

    x, y, z = (offset + one(f"tool offset {axis}") for offset, axis in zip(tool.offset, "xyz", strict=True))
    real = replace(tool, offset=(x, y, z), radius_error=tool.radius_error + one("radius error"))
    return ActualSetup(
        tool=_add_waviness(real, draw),
        machine=replace(machine, squareness=machine.squareness + one("squareness")),
        faster={name[-1]: value for name, value in draw.items() if name.startswith("servo ")},
        drift=(one("drift x", per_cut=True), one("drift z", per_cut=True)),
        mounting=terms("mounting"),
        tilt=(one("chuck tilt x", per_cut=True), one("chuck tilt y", per_cut=True)),
    )


def _add_waviness(tool: Tool, draw: Mapping[str, float]) -> Tool:
    """Return a tool with the drawn waviness added to its own, 0 at the tip."""
    powers = np.zeros(13)
    far = max(abs(end) for end in tool.arc)
    for name, value in draw.items():
        if name.startswith("waviness c"):
            powers[int(name[10:])] += value
        elif name.startswith("waviness P"):
            order = int(name[10:])
            series = np.zeros(order + 1)
            series[order] = value * math.sqrt(2 * order + 1)
            powers[: order + 1] += legendre.leg2poly(series) / far ** np.arange(order + 1.0)
    powers[0] = 0.0  # the tip is touched off
    if not powers.any():
        return tool
    if isinstance(tool.waviness, WavinessTable):
        table_of_tool = tool.waviness
        table = WavinessTable(
            sweep=table_of_tool.sweep, deviation=table_of_tool.deviation + np.polyval(powers[::-1], table_of_tool.sweep)
        )
        return replace(tool, waviness=table)
    powers[1 : 1 + len(tool.waviness)] += tool.waviness
    return replace(tool, waviness=tuple(np.trim_zeros(powers[1:], "b")))


def residual_setup(real: ActualSetup, tool: Tool, machine: Machine, found: Diagnosis) -> ActualSetup:
    """Return the set-up with the deviations that remain after a correction by the diagnosis.

    To first order in the errors, planning with the diagnosed tool and cutting with the actual one gives the same
    surface as planning with the nominal tool and cutting with nominal plus actual minus diagnosed tool.
    """
    likely_tool, likely_machine = found.likely_tool, found.likely_machine
    x, y, z = (
        plan + is_ - was for plan, is_, was in zip(tool.offset, real.tool.offset, likely_tool.offset, strict=True)
    )
    radius = tool.radius_error + real.tool.radius_error - likely_tool.radius_error
    tool_left = replace(real.tool, offset=(x, y, z), radius_error=radius)
    if likely_tool.waviness is not tool.waviness:
        sweep = np.linspace(*tool.arc, EDGE_POINTS)
        deviation = tool.deviation(sweep) + real.tool.deviation(sweep) - likely_tool.deviation(sweep)
        tool_left = replace(tool_left, waviness=WavinessTable(sweep=sweep, deviation=deviation))
    square = machine.squareness + real.machine.squareness - likely_machine.squareness
    slide = replace(real.machine, squareness=square)
    if likely_machine.straightness is not None and likely_machine.straightness is not machine.straightness:
        at, wrong = likely_machine.straightness
        actual_at, actual = real.machine.straightness or (at, np.zeros_like(wrong))
        plan_at, plan = machine.straightness or (at, np.zeros_like(wrong))
        every = np.unique(np.concatenate([at, actual_at, plan_at]))
        deviation = np.interp(every, actual_at, actual) + np.interp(every, plan_at, plan) - np.interp(every, at, wrong)
        slide = replace(slide, straightness=(every, deviation))
    return real._replace(tool=tool_left, machine=slide)


def bound_shift(budget: ErrorBudget, job: Job) -> ContactShift:
    """Return a bound on the shift of the contact point by the errors of a budget.

    Offset, slope of the edge waviness, drift and nose radius error shift it along the radius. The bound is twice their
    sum, to allow for errors of the diagnosis.
    """
    tool = job.tool
    far = max(abs(end) for end in tool.arc)
    waves = 0.0
    for name, spread in budget.errors.items():
        if name.startswith("waviness P"):
            order = int(name[10:])
            waves += spread.largest * math.sqrt(2 * order + 1) * order * (order + 1) / 2 / far
        elif name.startswith("waviness c"):
            order = int(name[10:])
            waves += spread.largest * order * far ** (order - 1)
    along = budget.largest("tool offset x", "drift x", "radius error") + waves
    servos = {name[-1]: spread.largest for name, spread in budget.errors.items() if name.startswith("servo ")}
    return ContactShift(along=2 * along, across=2 * budget.largest("tool offset y"), servos=servos)


def test_part_job(job: Job, kind: str) -> Job:
    """Return the job of a test part, with the same treatment of servos as for the part."""
    free = replace(job, program=replace(job.program, precorrect=False))
    made = make_test_part(free, kind)  # type: ignore[arg-type] # a budget knows no other
    return replace(made, simulation=replace(made.simulation, tracking=job.simulation.tracking), program=job.program)


def plan_cuts(
    job: Job, budget: ErrorBudget, store: Store, *, correction: bool, progress: Progress | None = None
) -> dict[str, Any]:
    """Plan the part and its test parts once, store the motions that the cases need, and return what all cases share."""
    report = progress or (lambda _done, _total: None)
    reach = bound_shift(budget, job)
    kinds = budget.test_parts if correction else ()
    jobs = {"": job} | {kind: test_part_job(job, kind) for kind in kinds}
    cuts: dict[str, Any] = {}
    for number, (kind, cut_job) in enumerate(jobs.items()):

        def update(done: int, total: int, number: int = number) -> None:
            report(number * total + done, len(jobs) * total)

        plan = plan_motion(cut_job, reach, update)
        feed = plan.motion.feed
        scenes = _scenes_of(cut_job, kind, feed)
        cuts[kind] = {
            "job": cut_job.to_toml(),
            "feed": feed,
            "scenes": [_put(plan, scene, reach, store) for scene in scenes],
        }
        del plan
    files = list_files(job.table())
    return {"budget": budget.table(), "cuts": cuts, "files": files, "kept": store_files(files, store)}


def _scenes_of(job: Job, kind: str, feed: float) -> list[Scene]:
    return [make_lines(job, feed, even=True)] if kind else make_scenes(job, feed)


def _put(plan: PlannedMotion, scene: Scene, reach: ContactShift, store: Store) -> dict[str, Any]:
    head, rows = pack_motion(plan, select_points(plan, scene, reach), reach)
    word = "".join(one if one.isalnum() else "-" for one in scene.name if one.isascii()) or "patch"
    return {**head, "array": store.put_array(f"motion-{word}", rows)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    scene: Scene
    head: Mapping[str, Any]
    rows: Floats
    share: Floats  # fraction of the final drift at each point, the same in all cases


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cut:
    job: Job
    feed: float
    views: tuple[_View, ...]

    def simulate(self, view: _View, real: ActualSetup) -> tuple[CutSurface, Floats]:
        """Return the cut surface on a sampling grid, and its form error after release from the mount. [mm]."""
        motion = scene_motion(view.head, view.rows, self.job.machine, real.faster)
        motion = add_drift(motion, *real.drift, view.share)
        cut = view.scene.generated(motion, real.tool, real.machine, view.head["near"])
        part = self.job.part
        surface, radius = part.continuation, part.reach
        shape, x, y = cut.z.shape, cut.x.ravel(), cut.y.ravel()
        needed = 1 if any(real.tilt) else 0
        f, *slopes = surface.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), needed)
        error = cut.z.ravel() - f
        if part.outline is not None:
            error[~part.covers(x, y)] = np.nan
        if real.mounting:
            # A part deformed by the mount springs back by the same amount.
            error -= Zernike(terms=real.mounting, radius=radius, indexing="fringe").sag(x, y)
        if needed:
            # A part cut with a tilt is measured against its flange, which is tilted by the opposite angle.
            about_x, about_y = real.tilt
            fx, fy = slopes
            error -= about_x * (y + f * fy) - about_y * (x + f * fx)
        return cut, error.reshape(shape)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaseContext:
    """Budget and planned cuts shared by the cases of a study."""

    budget: ErrorBudget
    cuts: Mapping[str, _Cut]

    @classmethod
    def of(cls, shared: Mapping[str, Any], store: Store) -> CaseContext:
        """Load the data that `plan_cuts` wrote to a store."""
        cuts, budget = {}, ErrorBudget.read(shared["budget"])
        with provide_files(shared["files"], shared["kept"], store) as places:
            jobs = {
                kind: Job.read(relocate_paths(tomllib.loads(head_of_cut["job"]), places))
                for kind, head_of_cut in shared["cuts"].items()
            }
            for job in jobs.values():  # what reads a file reads it now
                _ = job.actual_tool, job.actual_machine, job.part.aimed
        for kind, head_of_cut in shared["cuts"].items():
            job = jobs[kind]
            feed = head_of_cut["feed"]
            scenes = _scenes_of(job, kind, feed)
            views = []
            for scene, head in zip(scenes, head_of_cut["scenes"], strict=True):
                rows = fetch_array(store, head["array"])
                share = drift_share(rows[0], head["duration"], budget.settling)
                views.append(_View(scene=scene, head=head, rows=rows, share=share))
            cuts[kind] = _Cut(job=job, feed=feed, views=tuple(views))
        return cls(budget=budget, cuts=cuts)

    def real(self, draw: Mapping[str, float], cut: str = "") -> ActualSetup:
        """Return the actual set-up of a draw."""
        job = self.cuts[""].job
        real = apply_draw(job.actual_tool, job.actual_machine, draw, cut)
        return real if servos_respond(job) else real._replace(faster={})

    def measure(self, real: ActualSetup) -> tuple[dict[str, float], Floats]:
        """Return the measures of a part, and its form error along the lines. [nm]."""
        part = self.cuts[""]
        numbers: dict[str, float] = {}
        form: Floats | None = None
        for view in part.views:
            cut, error = part.simulate(view, real)
            if view.scene.polar:
                form = form_error(part.job, cut, error)
                weight = np.broadcast_to(cut.weight, form.shape)[np.isfinite(form)]
                there = form[np.isfinite(form)]
                numbers["form_pv_nm"] = float(np.ptp(there)) * NM
                numbers["form_rms_nm"] = math.sqrt(float(np.average(there**2, weights=weight))) * NM
                if (light := part.job.optics) is not None:
                    path = there * path_per_height(
                        part.job.part.design.surface, cut.x[np.isfinite(form)], cut.y[np.isfinite(form)],
                        index=light.index, source=light.source, inside=light.inside,
                    )  # fmt: skip
                    path -= np.average(path, weights=weight)
                    numbers["wavefront_rms_nm"] = math.sqrt(float(np.average(path**2, weights=weight))) * NM
                continue
            patch = HeightMap(z=error, x=view.scene.columns, y=view.scene.rows)
            residual = remove_form(patch, part.job.roughness.form).z
            numbers[f"sq_nm@{view.scene.name}"] = math.sqrt(float(np.nanmean(residual**2))) * NM
            numbers[f"sa_nm@{view.scene.name}"] = float(np.nanmean(np.abs(residual))) * NM
        assert form is not None  # noqa: S101 - the lines are always among the scenes
        return numbers, form * NM

    def diagnose_test_parts(self, draw: Mapping[str, float], seed: object) -> Diagnosis:
        """Simulate cutting and measuring the test parts with the actual set-up, and diagnose them."""
        rng = np.random.default_rng(seed)  # type: ignore[arg-type] # a list of whole numbers
        job = self.cuts[""].job
        measurement = job.measurement
        maps, parts = [], []
        for kind, cut in self.cuts.items():
            if not kind:
                continue
            surface, error = cut.simulate(cut.views[0], self.real(draw, kind))
            design = cut.job.part
            x, y = surface.x.ravel(), surface.y.ravel()
            seen = error.ravel() + rng.normal(0.0, 1.0, x.size) * self.budget.noise
            head = f"{kind}: instrument Z"
            terms = {int(name[len(head) :]): value for name, value in draw.items() if name.startswith(head)}
            if terms:
                seen += Zernike(terms=terms, radius=design.reach, indexing="fringe").sag(x, y)
            maps.append(HeightMap(x=x, y=y, z=seen + design.surface.sag(x, y), name=kind))
            parts.append(design)
        return diagnose(
            maps, parts, job.tool, job.machine,
            error_sources=measurement.error_sources or DEFAULT,
            free=[one for one in FREE if one not in measurement.fixed],
            waviness=measurement.waviness, sense=job.strategy.sense, feed=next(iter(self.cuts.values())).feed,
            min_effect_nm=measurement.min_effect * NM,
        )  # fmt: skip


def form_error(job: Job, cut: CutSurface, error: Floats) -> Floats:
    """Return the deviation from the nominal surface after a fit of the free rigid motions.

    The free motions are those of the job's ``measurement``: ``free`` without ``fixed``. The fit weights each place by
    its area.
    """
    measurement = job.measurement
    fixed = {"piston": ("z",), "tilt": ("tilt_x", "tilt_y"), "decentre": ("x", "y"), "clocking": ("rotation",)}
    fixed_motions = {name for one in measurement.fixed for name in fixed[one]}
    x, y = (np.ascontiguousarray(one.ravel()) for one in (cut.x, cut.y))
    f, fx, fy = job.part.continuation.evaluate(x, y, 1)
    signatures = {
        "z": np.ones(x.size),
        "tilt_x": y + f * fy,
        "tilt_y": x + f * fx,
        "x": fx,
        "y": fy,
        "rotation": x * fy - y * fx,
    }
    # Scaled, so that a signature that is zero up to rounding, such as the rotation of a sphere, is not fitted.
    far, steep = float(np.hypot(x, y).max()), max(float(np.hypot(fx, fy).max()), MIN_SLOPE)
    sizes = dict.fromkeys(signatures, far) | {"z": 1.0, "x": steep, "y": steep, "rotation": far * steep}
    columns = [
        signatures[name] / sizes[name] for name in signatures if name in measurement.free and name not in fixed_motions
    ]
    flat = error.ravel()
    if not columns:
        return error
    there = np.isfinite(flat)
    root = np.sqrt(np.broadcast_to(cut.weight, error.shape)).ravel()
    matrix = np.stack(columns, axis=1)
    share = np.linalg.lstsq(matrix[there] * root[there, None], flat[there] * root[there], rcond=RANK_TOL)[0]
    return np.asarray((flat - matrix @ share).reshape(error.shape), dtype=np.float64)


def carry_out(data: Mapping[str, Any], shared: Mapping[str, Any], store: Store | None) -> Row:
    """Return the row of one case, and write its form errors to the store; the work function of `run_cases`."""
    assert store is not None  # noqa: S101 - a study of tolerances always has one
    bench = _benches.get(data["study"])
    if bench is None:
        bench = CaseContext.of(shared, store)
        _benches.clear()
        _benches[data["study"]] = bench
    draw = data["draw"]
    real = bench.real(draw)
    numbers, form = bench.measure(real)
    row: Row = {**numbers, "map": store.put_array("form", form)}
    if data["correction"]:
        job = bench.cuts[""].job
        diagnosis = bench.diagnose_test_parts(draw, data["seed"])
        # If `turnwright.correct` would write no correction, the part is cut as planned.
        draws = diagnosis.effects_on(job.part)
        certain = prove(draws, np.zeros(draws.x.size), min_effect_nm=job.measurement.min_effect * NM).ok
        setup = residual_setup(real, job.tool, job.machine, diagnosis) if certain else real
        better, form = bench.measure(setup)
        row |= {f"corrected {name}": value for name, value in better.items()}
        row["corrected map"] = store.put_array("form", form)
    return row
