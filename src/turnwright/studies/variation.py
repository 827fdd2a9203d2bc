"""Parameter studies: a job with some fields varied, and measures of every case."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from turnwright import _validate as validate
from turnwright._arrays import Bools, Floats, frozen
from turnwright._io import write_atomic
from turnwright.errors import InputError, JobError, StudyError
from turnwright.job import Job
from turnwright.studies.cases import Case, case_key, run_cases
from turnwright.studies.designs import MAX_CASES, Vary, design_cases, get_job_value, read_varied
from turnwright.studies.executors import local
from turnwright.studies.fields import apply_changes, get_job_data
from turnwright.studies.files import list_files, store_files
from turnwright.studies.measures import REFUSED, SECONDS, Measure, MeasureFunction, carry_out, measure_of
from turnwright.studies.store import Store

if TYPE_CHECKING:
    from os import PathLike

    from turnwright.progress import Progress

__all__ = ["Column", "Grid", "Study", "study"]

Kind: TypeAlias = Literal["number", "whole", "text", "flag"]

REASON = "reason"
FORM = 1
"""Version of what `Study.save` writes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """A column of a study's table: a field that was varied, or a measure.

    Parameters
    ----------
    name
        Name of the field or measure, as requested.
    unit
        Unit of the values; empty if there is none, or if the name contains it.
    values
        One value for each case; nan, or an empty text, where there is none. (n,)
    job_value
        Value of a field in the job, in the same unit; ``None`` if the job states none.
    """

    name: str
    unit: str
    values: NDArray[Any]
    job_value: float | int | str | bool | None = None

    @property
    def heading(self) -> str:
        """The name with its unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def kind(self) -> Kind:
        """Type of the values: "number", "whole" (numbers), "text" or "flag"."""
        kinds: dict[str, Kind] = {"f": "number", "i": "whole", "b": "flag"}
        return kinds.get(self.values.dtype.kind, "text")

    @property
    def different(self) -> NDArray[Any]:
        """Distinct values, ascending."""
        return np.unique(self.values)


class Grid(NamedTuple):
    """A measure over two fields.

    Parameters
    ----------
    rows, columns
        Values of the first and the second field. (n,), (m,)
    values
        Values of the measure; nan where there is none. (n, m)
    ok
        Whether `run` would accept the case. (n, m)
    """

    rows: NDArray[Any]
    columns: NDArray[Any]
    values: Floats
    ok: Bools


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Study:
    """Table of the cases of a parameter study.

    ``study["sq_nm"]`` is a column, ``study[3]`` a case.

    Parameters
    ----------
    job
        The job whose fields were varied.
    design
        Design of the study, see `study`.
    fields
        Varied fields.
    measures
        Measures.
    reasons
        For every case the reason why it failed or why `run` would refuse it; empty if neither. A case that `run` would
        refuse (the tool does not reach, or a limit is exceeded) still has measures. (n,)
    seconds
        Computing time of every case; nan for failed ones. (n,) [s]
    """

    job: Job
    design: str
    fields: tuple[Column, ...]
    measures: tuple[Column, ...]
    reasons: tuple[str, ...]
    seconds: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        validate.check_numbers(self, nan=("seconds",))
        for one in (*self.fields, *self.measures):
            one.values.flags.writeable = False
        object.__setattr__(self, "seconds", frozen(self.seconds, "seconds", finite=False))

    def __len__(self) -> int:
        return len(self.reasons)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Fields and measures."""
        return (*self.fields, *self.measures)

    @property
    def ok(self) -> Bools:
        """Whether `run` would accept each case. (n,)."""
        return np.array([not reason for reason in self.reasons], dtype=np.bool_)

    @property
    def table(self) -> list[dict[str, Any]]:
        """All cases, each as a mapping of fields, measures and ``reason``."""
        return [self[number] for number in range(len(self))]

    def column(self, name: str) -> Column:
        """Return a field or a measure by its name.

        Raises
        ------
        InputError
            If there is none.
        """
        for one in self.columns:
            if isinstance(name, str) and one.name == name:
                return one
        raise InputError(f"the study has no column {name!r}, it has {', '.join(one.name for one in self.columns)}")

    @overload
    def __getitem__(self, which: str) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, which: int) -> dict[str, Any]: ...
    def __getitem__(self, which: str | int) -> NDArray[Any] | dict[str, Any]:
        """Return the values of a column by its name, or a case by its number."""
        if isinstance(which, str):
            return self.column(which).values
        if isinstance(which, bool) or not isinstance(which, int | np.integer) or abs(which) > MAX_CASES:
            raise InputError(f"{which!r} is neither a column nor the number of a case: give one of them")
        reason = self.reasons[which]  # raises IndexError where there is no such case, which ends a loop over all
        return {**{one.name: one.values[which].item() for one in self.columns}, REASON: reason}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.table)

    def best(self, measure: str, count: int = 10, *, largest: bool = False) -> list[int]:
        """Return the numbers of the best cases that `run` would accept, the best first.

        Parameters
        ----------
        measure
            Name of the measure to rank by.
        count
            Largest number of cases to return.
        largest
            Whether larger values are better.
        """
        count = validate.whole_number(count, "the number of cases", 0)
        values = self.column(measure).values
        if values.dtype.kind not in "fi":
            raise InputError(f"{measure} is not a number, so no case is best: name another measure")
        order = np.argsort(-values if largest else values, kind="stable")
        return [int(one) for one in order if self.ok[one] and np.isfinite(values[one])][:count]

    def grid(self, measure: str, *, over: tuple[str, str] | None = None, at: Mapping[str, Any] | None = None) -> Grid:
        """Return a measure over two fields, for a contour plot.

        Parameters
        ----------
        measure
            Its name.
        over
            The two fields, rows first; the first two if not given.
        at
            Values of all other fields.

        Raises
        ------
        InputError
            If a field is missing, or several cases have the same values of both fields.
        """
        if over is None:
            if len(self.fields) < 2:
                raise InputError(f"a map is over 2 fields, the study varies {len(self.fields)}: draw a line")
            over = self.fields[0].name, self.fields[1].name
        if not isinstance(over, tuple | list) or len(over) != 2:
            raise InputError(f"a map is over {over!r}, it must be over 2 fields: name them")
        selected = np.ones(len(self), dtype=np.bool_)
        for name, value in (at or {}).items():
            column = self.column(name).values
            if column.dtype.kind == "f":
                selected &= np.isclose(column, validate.number(value, name), rtol=1e-12, atol=0)
            else:
                selected &= np.array([one == value for one in column.tolist()], dtype=np.bool_)
        rows, row = np.unique(self.column(over[0]).values[selected], return_inverse=True)
        columns, place = np.unique(self.column(over[1]).values[selected], return_inverse=True)
        if rows.size * columns.size == 0:
            raise InputError(f"no case has the values {dict(at or {})}: choose values of the study")
        if np.unique(row * columns.size + place).size < row.size:
            others = [one.name for one in self.fields if one.name not in over and one.name not in (at or {})]
            raise InputError(
                f"several cases have the same {over[0]} and {over[1]}: fix {', '.join(others) or 'the cases'} by at"
            )
        values, ok = np.full((rows.size, columns.size), np.nan), np.zeros((rows.size, columns.size), dtype=np.bool_)
        values[row, place] = self.column(measure).values[selected]
        ok[row, place] = self.ok[selected]
        return Grid(rows, columns, values, ok)

    @property
    def is_grid(self) -> bool:
        """Whether every value of each field meets every value of the others."""
        if not self.fields:
            return False
        places = np.stack([np.unique(one.values, return_inverse=True)[1] for one in self.fields])
        cells = int(np.prod([one.different.size for one in self.fields], dtype=np.int64))
        return bool(cells == len(self) == np.unique(places, axis=1).shape[1])

    @property
    def _written(self) -> list[NDArray[Any]]:
        """Columns of the written table, see `headings`."""
        numbers = np.arange(1, len(self) + 1)
        return [numbers, *(one.values for one in self.columns), self.seconds, np.array(self.reasons, dtype=np.str_)]

    @property
    def headings(self) -> list[str]:
        """Headings of the written table, with units in brackets."""
        return ["case", *(one.heading for one in self.columns), "seconds", REASON]

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the table as CSV: one row for each case, units in the headings, numbers with all digits."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.headings)
        for row in zip(*(values.tolist() for values in self._written), strict=True):
            writer.writerow([_cell(one) for one in row])
        write_atomic(Path(validate.path(path, "the table")), text.getvalue())

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Write the table as Parquet, with the job in its metadata; needs pyarrow, extra `parquet`.

        Raises
        ------
        InputError
            If pyarrow is not installed.
        """
        try:
            import pyarrow as pa  # noqa: PLC0415 - of an extra
            from pyarrow import parquet  # noqa: PLC0415
        except ImportError:
            raise InputError(
                "Parquet needs pyarrow, which is not installed: pip install 'turnwright[parquet]', or write CSV"
            ) from None
        table = pa.table(dict(zip(self.headings, map(pa.array, self._written), strict=True)))
        table = table.replace_schema_metadata({"turnwright.job": self.job.to_toml(), "turnwright.design": self.design})
        sink = io.BytesIO()
        parquet.write_table(table, sink)
        write_atomic(Path(validate.path(path, "the table")), sink.getvalue())

    def save(self, folder: str | PathLike[str]) -> None:
        """Write the study into a folder: ``study.csv``, ``study.json`` and ``job.toml``, which `load` reads again."""
        folder = Path(validate.path(folder, "the folder of a study"))
        folder.mkdir(parents=True, exist_ok=True)
        header = {
            "form": FORM,
            "design": self.design,
            "cases": len(self),
            "fields": [
                {"name": one.name, "unit": one.unit, "kind": one.kind, "own": one.job_value} for one in self.fields
            ],
            "measures": [{"name": one.name, "unit": one.unit, "kind": one.kind} for one in self.measures],
        }
        self.job.dump(folder / "job.toml")
        write_atomic(folder / "study.json", json.dumps(header, indent=1) + "\n")
        self.to_csv(folder / "study.csv")

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """Read a study that `save`, or ``turnwright study``, wrote.

        Raises
        ------
        StudyError
            If the folder holds none.
        """
        folder = Path(validate.path(folder, "the folder of a study"))
        try:
            header = json.loads((folder / "study.json").read_text(encoding="utf-8"))
            if header["form"] != FORM:
                raise StudyError(
                    f"the study in {str(folder)!r} has the form {header['form']}, this program reads {FORM}: update it"
                )
            cells = _cells(folder / "study.csv", header["cases"])
            return cls(
                job=Job.load(folder / "job.toml"),
                design=header["design"],
                fields=tuple(_column(one, cells) for one in header["fields"]),
                measures=tuple(_column(one, cells) for one in header["measures"]),
                reasons=tuple(cells[REASON]),
                seconds=_array("number", cells["seconds"]),
            )
        except (OSError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, StudyError | JobError):
                raise
            what = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            raise StudyError(
                f"the folder {str(folder)!r} holds no complete study ({what}): name one that turnwright study wrote"
            ) from error


def _cells(file: Path, count: int) -> dict[str, tuple[str, ...]]:
    with file.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    if len(rows) != count:
        raise ValueError(f"{count} cases were written, {len(rows)} are there")
    return dict(zip(head, zip(*rows, strict=True), strict=True))


def _column(header: Mapping[str, Any], cells: Mapping[str, Sequence[str]]) -> Column:
    name, unit = header["name"], header["unit"]
    values = _array(header["kind"], cells[f"{name} [{unit}]" if unit else name])
    return Column(name=name, unit=unit, values=values, job_value=header.get("own"))


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _array(kind: str, values: Sequence[Any]) -> NDArray[Any]:
    """Return a column of values, read or computed; None is nan, or an empty text."""
    if kind == "flag":
        return np.array([value in (True, "true") for value in values], dtype=np.bool_)
    if kind == "whole":
        return np.array([int(value) for value in values], dtype=np.int64)
    if kind == "text":
        return np.array(["" if value is None else str(value) for value in values], dtype=np.str_)
    return np.array([np.nan if value in (None, "") else float(value) for value in values], dtype=np.float64)


def _kind(values: Sequence[Any]) -> Kind:
    numbers = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in numbers):
        return "text"
    if numbers and all(isinstance(value, bool) for value in numbers):
        return "flag"
    return "whole" if len(numbers) == len(values) and all(isinstance(value, int) for value in numbers) else "number"


def study(
    job: Job,
    *,
    vary: Mapping[str, Vary] | None = None,
    measure: str | MeasureFunction | Sequence[str | MeasureFunction],
    design: str | Sequence[Mapping[str, Any]] = "grid",
    count: int | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    store: str | PathLike[str] | Store | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Vary fields of a job and evaluate measures of every case.

    Each case computes only what its measures need: the roughness of a patch needs the revolutions over it, minutes the
    whole path. A case that ``run`` would refuse is evaluated too and has a reason. Tool access is always checked, the
    limits of the machine only if a measure needs the whole motion.

    Parameters
    ----------
    job
        The job.
    vary
        By the dotted name of a field, as in the job file: a text ("0.1..1 mm:10", "2..200 um:9 log",
        "2, 4, 8 um/rev", "normal(0.5, 0.01) mm"), a list of numbers (mm, rad, mm/rev, rpm) or texts, or a frozen
        distribution of ``scipy.stats``. Entries of lists are named, or counted from 1 ("actual.tool.offset[1]"). A feed
        may be given per minute ("0.2..1 mm/min:9"): it is divided by the spindle speed of the same case.
    measure
        Names such as "sq_nm", "sq_nm@PATCH", "minutes" or "peak_acceleration@X", or functions of `Pipeline` (top-level
        ones of a module, so that other processes find them).
    design
        "grid", "random", "sobol", "halton", "latin hypercube", or a list of cases, each a mapping from field to value.
    count, seed
        Number of cases and seed of a random design. The same seed gives the same cases, so that a study can continue.
    executor
        Any `concurrent.futures.Executor`; by default processes of this machine.
    store
        A folder, URL or `Store` of finished cases, which are not computed again if the study is interrupted and
        repeated.
    workers
        Number of processes without an executor; by default one per core, limited by free memory.
    progress
        Called with (done, total).

    Raises
    ------
    InputError
        If a field, a value, a measure or the design is wrong; before anything is computed.
    StudyError
        If the executor breaks or the store is full; finished cases are kept in the store.

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> job = Job.read({
    ...     "part": {"surface": {"family": "plane"}, "radius": "2 mm"},
    ...     "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    ...     "machine": {"name": "generic"},
    ...     "strategy": {
    ...         "kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 240, "spindle_speed": "100 rpm",
    ...     },
    ... })
    >>> with ThreadPoolExecutor(2) as threads:
    ...     found = study(
    ...         job, vary={"strategy.feed": "5, 10, 20 um/rev"}, measure=["minutes", "points"], executor=threads
    ...     )
    >>> found["minutes"].round(1).tolist()
    [4.0, 2.0, 1.0]
    >>> found[2]["strategy.feed"], found[2]["reason"]
    (20.0, '')
    """
    validate.instance_of(job, Job, "the job")
    if vary is not None:
        validate.instance_of(vary, Mapping, "the fields to vary")
    if executor is not None:
        validate.instance_of(executor, Executor, "the executor")
    if workers is not None:
        workers = validate.whole_number(workers, "the number of workers", 1)
    validate.listener(progress)
    fields, rows = design_cases(
        job,
        [read_varied(job, name, value) for name, value in (vary or {}).items()],
        design=design,
        count=count,
        seed=seed,
    )
    requested: Any = measure if isinstance(measure, list | tuple) else [measure]
    measures = [measure_of(job, one) for one in requested]
    _check_measures(measures)
    place = Store.open(store) if store is not None and not isinstance(store, Store) else store
    files = list_files(job.table())
    shared = {
        "measures": [one.name for one in measures],
        "own": {one.name: one.function for one in measures if one.function is not None},
        "files": store_files(files, place),
    }
    columns = tuple(
        Column(
            name=one.name,
            unit=one.unit,
            values=_array("number" if one.field.kind == "quantity" else one.field.kind, values),
            job_value=get_job_value(job, one),
        )
        for one, values in zip(fields, zip(*rows, strict=True), strict=True)
    )
    base, signs = get_job_data(job), [one.sign for one in measures]
    cases = []
    for row in rows:
        changes = [(one.field, one.unit, token) for one, token in zip(fields, row, strict=True)]
        data = {"job": apply_changes(base, changes), "files": files}
        cases.append(Case(key=case_key({**data, "measures": signs}), data=data))
    several = local(None if workers is None else min(workers, len(cases))) if executor is None else None
    with several or nullcontext(executor) as pool:
        rows_of_cases = run_cases(carry_out, cases, shared=shared, executor=pool, store=place, progress=progress)
    return Study(
        job=job,
        design=design if isinstance(design, str) else "list",
        fields=columns,
        measures=tuple(_measure_column(one, rows_of_cases) for one in measures),
        reasons=tuple("; ".join(str(row.get(REASON) or row.get(REFUSED) or "").splitlines()) for row in rows_of_cases),
        seconds=_array("number", [row.get(SECONDS) for row in rows_of_cases]),
    )


def _measure_column(one: Measure, found: Sequence[Mapping[str, Any]]) -> Column:
    values = [row.get(one.name) for row in found]
    return Column(name=one.name, unit=one.unit, values=_array(_kind(values), values))


def _check_measures(measures: Sequence[Measure]) -> None:
    if not measures:
        raise InputError("nothing is measured: name at least 1 measure, such as minutes")
    names = [one.name for one in measures]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} is measured {names.count(name)} times, the limit is 1: keep one of them")
        if name in (REASON, REFUSED, SECONDS):
            raise InputError(f"a measure has the name {name}, which the table has already: rename the function")
