"""JSON models of the API."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from annotated_types import MaxLen
from fastapi import Path, Query
from pydantic import BaseModel, ConfigDict, Field

from turnwright.web.limits import BODY_BYTES

__all__ = [
    "BINARY",
    "About",
    "Check",
    "Coordinate",
    "Data",
    "Edited",
    "ErrorSources",
    "ExampleJob",
    "ExampleLine",
    "Fault",
    "FileName",
    "Id",
    "Kept",
    "Limits",
    "Line",
    "Lines",
    "Measurement",
    "NewRun",
    "Opened",
    "Parsed",
    "Preview",
    "Problem",
    "Progress",
    "Question",
    "RunDetail",
    "RunFile",
    "RunId",
    "RunLine",
    "RunState",
    "Toml",
    "Written",
    "answer_of",
]


BINARY = {"type": "string", "format": "binary"}
"""JSON schema of a file."""

RunId = Annotated[str, Path(pattern="^[0-9a-f]{16}$", description="Identifier of the run.")]
Coordinate = Annotated[float, Query(ge=-1e5, le=1e5, allow_inf_nan=False, description="[mm]")]
FileName = Annotated[str, Query(min_length=1, max_length=200, description="Name of the file.")]


def answer_of(description: str, media_type: str, schema: Mapping[str, str] = BINARY) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses of a route that does not return JSON of a model."""
    return {200: {"description": description, "content": {media_type: {"schema": schema}}}}


class Model(BaseModel):
    """A JSON object without additional properties."""

    model_config = ConfigDict(extra="forbid")


class Problem(Model):
    """Why a request is refused."""

    detail: str = Field(description="One sentence: field, value, limit, remedy.")


class Fault(Model):
    """A fault of one field."""

    field: str = Field(description='Path such as "passes[1].feed", counted from 1; empty for the whole job.')
    sentence: str = Field(description="Field, value, limit, remedy.")


class Limits(Model):
    """Limits of the server."""

    body_bytes: int = Field(description="Size of a JSON request. [byte]")
    upload_bytes: int = Field(description="Size of a measured file. [byte]")
    file_bytes: int = Field(description="Size of a file that a job names. [byte]")
    points: int = Field(description="Points of a program.")
    at_a_time: int = Field(description="Number of parallel runs; the others wait.")
    map_types: list[str] = Field(description="File name extensions of measured maps.")


class About(Model):
    """The server."""

    version: str
    examples: list[str]
    limits: Limits


class ExampleLine(Model):
    """An example in a list."""

    name: str
    title: str
    summary: str


class Toml(Model):
    """A job file."""

    toml: Annotated[str, MaxLen(BODY_BYTES)]


class Data(Model):
    """A job as data, with quantities as text with units."""

    data: dict[str, Any]


class Edited(Data):
    """A job as data, and its text before the change."""

    toml: Annotated[str, MaxLen(BODY_BYTES)] = Field(
        default="",
        description="Text whose comments and layout are kept; if empty, the job is written from the data alone.",
    )


class Question(Data):
    """A job and its client: of several requests of one client only the last is answered."""

    client: Annotated[str, MaxLen(64)] = Field(default="", description="Any text that identifies a page.")


class Kept(Model):
    """An uploaded file for a job."""

    reference: str = Field(description="Reference for use in a job.")
    name: str = Field(description="File name when it is downloaded with the job.")
    bytes: int


class Parsed(Model):
    """A job file as data."""

    data: dict[str, Any]
    errors: list[Fault]


class ExampleJob(Parsed):
    """An example."""

    toml: str


class Opened(ExampleJob):
    """The job of an archive, with references to the files that came with it."""


class Written(Model):
    """A job as a file."""

    toml: str
    errors: list[Fault]


class AccessFinding(Model):
    """One check of tool access, see `turnwright.access.AccessFinding`."""

    name: str
    value: float | None
    limit: float | None
    margin: float | None
    where: tuple[float, float] | None
    ok: bool
    sentence: str


class Access(Model):
    """Tool access to the part, see `turnwright.access.Access`."""

    ok: bool
    nose_radius_limit: float | None
    sweep: tuple[float | None, float | None]
    included_needed: float | None
    clearance_needed: float | None
    rake_range: tuple[float | None, float | None]
    findings: list[AccessFinding]


class Preview(Model):
    """Length of the program by pass, and remarks."""

    points: dict[str, int]
    shortest_s: dict[str, float | None]
    refused: list[str] = Field(description="Reasons why a run would refuse the job.")
    shape: dict[str, str] = Field(description="Shape of the surface over the clear aperture, by quantity.")
    remarks: list[str] = Field(description="Derived values that the job does not state.")
    unjudged: list[str] = Field(description="Stated tolerances, which only a run evaluates.")


class Check(Model):
    """Result of checking a job."""

    errors: list[Fault]
    access: Access | None
    preview: Preview | None
    chips: dict[str, str]
    warnings: list[str]


State = Literal["queued", "running", "done", "failed", "cancelled"]
Time = Annotated[str, Field(description="ISO 8601 time in UTC.")]


class NewRun(Edited):
    """A job to be carried out."""

    kind: Literal["run", "compare"]
    name: Annotated[str, MaxLen(120)] = Field(default="", description="Name; if empty, that of the part.")


class Id(Model):
    """Identifier of a new run."""

    id: str


class Progress(Model):
    """Progress of a run."""

    stage: str
    step: int = Field(description="Number of the stage, counted from 1.")
    steps: int
    fraction: float = Field(description="Completed fraction of the work; it never decreases.")
    left_s: float = Field(description="Estimated remaining time. [s]")


class RunState(Model):
    """State of a run."""

    id: str
    name: str
    kind: Literal["run", "compare", "measure", "correct"]
    state: State = "queued"
    created: Time
    started: Time | None = None
    ended: Time | None = None
    sentence: str = Field(default="", description="Outcome.")
    missed: bool = Field(default=False, description="Whether the part misses a stated tolerance.")
    of: str = Field(
        default="",
        description="Identifier of the measured run, for a measurement; of the measurement, for a correction.",
    )


class RunLine(RunState):
    """A run in a list."""

    progress: Progress | None = Field(default=None, description="Progress of a running run.")


class RunFile(Model):
    """A file of a run."""

    name: str = Field(description="Label in the API.")
    part: int = Field(description="Number among files of this label; a program may have sub-programs.")
    file: str = Field(description="File name.")
    bytes: int


class RunDetail(RunLine):
    """A run."""

    data: dict[str, Any] = Field(description="The job; of a correction, the corrected one.")
    toml: str = Field(description="Text of the job that was run or measured; empty if there is none.")
    files: list[RunFile]


class Lines(Model):
    """Some lines of a program."""

    lines: list[str]
    total: int
    places: list[tuple[float, float, float] | None] = Field(
        description="Tip position after each line in the part frame; null for a line without motion. [mm]"
    )


class Line(Model):
    """The number of a line, from 0."""

    line: int


class Measurement(Model):
    """A measured part; results are present only when it is done."""

    id: str
    name: str
    run: str
    state: State
    sentence: str
    progress: Progress | None
    form_pv_nm: float | None = None
    form_rms_nm: float | None = None
    outliers: int | None = None
    measured_rms_nm: float | None = None
    explained_rms_nm: float | None = None
    unexplained_rms_nm: float | None = None
    alignment: dict[str, Any] | None = None
    roughness: dict[str, Any] | None = None
    zernike: list[dict[str, Any]] = []
    psd: dict[str, Any] | None = None
    lenslets: list[dict[str, Any]] = []
    findings: list[dict[str, Any]] = []
    contributions: list[dict[str, Any]] = []
    correction: str | None = Field(default=None, description="Identifier of the last correction.")
    predicted: dict[str, Any] | None = Field(
        default=None, description="Predicted and simulated residual after correction, and the tolerances it misses."
    )


class ErrorSources(Model):
    """Error sources to correct."""

    error_sources: Annotated[list[Annotated[str, MaxLen(60)]], MaxLen(40)]
