"""What goes over the wire as JSON: the words of the OpenAPI schema."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import MaxLen
from pydantic import BaseModel, ConfigDict, Field

from turnwright.web.limits import BODY_BYTES

__all__ = [
    "About",
    "Causes",
    "Check",
    "Data",
    "Edited",
    "ExampleJob",
    "ExampleLine",
    "Fault",
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
    "RunLine",
    "Toml",
    "Written",
    "archived",
]


def archived(description: str) -> dict[int | str, dict[str, Any]]:
    """Return what the schema says of an answer that is a ZIP archive."""
    content = {"application/zip": {"schema": {"type": "string", "format": "binary"}}}
    return {200: {"description": description, "content": content}}


class Model(BaseModel):
    """A table of JSON."""

    model_config = ConfigDict(extra="forbid")


class Problem(Model):
    """Why a request is refused."""

    detail: str = Field(description="One sentence: what, how much, the limit, the remedy.")


class Fault(Model):
    """What is wrong with one field."""

    field: str = Field(description='Its place, such as "passes[1].feed", counting from 1; empty for the whole job.')
    sentence: str = Field(description="What, how much, the limit, the remedy.")


class Limits(Model):
    """What the server takes."""

    body_bytes: int = Field(description="Of JSON. [byte]")
    upload_bytes: int = Field(description="Of a measured file. [byte]")
    file_bytes: int = Field(description="Of a file that a job names. [byte]")
    points: int = Field(description="Of a program that is made from a page.")
    at_a_time: int = Field(description="Runs that are carried out at a time; the others wait.")
    map_types: list[str] = Field(description="Endings of measured files.")


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
    """A job as data: what its file says, quantities as text with units."""

    data: dict[str, Any]


class Edited(Data):
    """A job as data, and the text that it was before it was changed."""

    toml: Annotated[str, MaxLen(BODY_BYTES)] = Field(
        default="", description="Remarks and layout of this text are kept; without it the job is written anew."
    )


class Question(Data):
    """A job and who asks, so that of several questions of one page only the last is answered."""

    client: Annotated[str, MaxLen(64)] = Field(default="", description="Any text that one page always sends.")


class Kept(Model):
    """A file that was brought for a job."""

    reference: str = Field(description="By which a job names it.")
    name: str = Field(description="What it is called beside the job when both are taken away.")
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
    """One thing that was looked at, see `turnwright.access.AccessFinding`."""

    name: str
    value: float | None
    limit: float | None
    margin: float | None
    where: tuple[float, float] | None
    ok: bool
    sentence: str


class Access(Model):
    """Whether the tool reaches the part, see `turnwright.access.Access`."""

    ok: bool
    nose_radius_limit: float | None
    sweep: tuple[float | None, float | None]
    included_needed: float | None
    clearance_needed: float | None
    rake_range: tuple[float | None, float | None]
    findings: list[AccessFinding]


class Preview(Model):
    """How long the program will be, by pass."""

    points: dict[str, int]
    shortest_s: dict[str, float | None]
    refused: list[str] = Field(description="Why a run would refuse the job.")
    shape: dict[str, str] = Field(description="What the surface looks like over the clear aperture, by quantity.")
    remarks: list[str] = Field(description="What was worked out for the surface and the job does not state.")
    unjudged: list[str] = Field(description="Stated tolerances, which only a run judges.")


class Check(Model):
    """What can be said of a job at once."""

    errors: list[Fault]
    access: Access | None
    preview: Preview | None
    chips: dict[str, str]
    warnings: list[str]


RunKind = Literal["run", "compare", "measure", "correct"]
RunState = Literal["queued", "running", "done", "failed", "cancelled"]
Time = Annotated[str, Field(description="In UTC as ISO 8601 writes it.")]


class NewRun(Edited):
    """A job to be carried out."""

    kind: Literal["run", "compare"]
    name: Annotated[str, MaxLen(120)] = Field(default="", description="That of the part if empty.")


class Id(Model):
    """What was begun."""

    id: str


class Progress(Model):
    """How far a whole run is."""

    stage: str
    step: int = Field(description="Number of the stage, counted from 1.")
    steps: int
    fraction: float = Field(description="Of the work that is done; it never falls.")
    left_s: float = Field(description="Until all is done, estimated.")


class RunLine(Model):
    """A run in a list."""

    id: str
    name: str
    kind: RunKind
    state: RunState
    created: Time
    started: Time | None
    ended: Time | None
    sentence: str = Field(description="How it ended.")
    missed: bool = Field(description="Whether its part misses a stated tolerance.")
    of: str = Field(description="The run that a measurement belongs to, or the measurement that a correction does.")
    progress: Progress | None = Field(description="Of a run that is under way.")


class RunFile(Model):
    """A file that a run has left."""

    name: str = Field(description="By which it is asked for.")
    part: int = Field(description="Which of several of that name; a program may have sub-programs.")
    file: str = Field(description="What it is called on disk.")
    bytes: int


class RunDetail(RunLine):
    """A run."""

    data: dict[str, Any] = Field(description="The job; of a correction, the corrected one.")
    toml: str = Field(description="What a person wrote of the job that was run or measured; empty if nobody did.")
    files: list[RunFile]


class Lines(Model):
    """Some lines of a program."""

    lines: list[str]
    total: int
    places: list[tuple[float, float, float] | None] = Field(
        description="Where the tip is after each line, in the part frame; null for one that moves nothing. [mm]"
    )


class Line(Model):
    """The number of a line, from 0."""

    line: int


class Measurement(Model):
    """A measured part; all but the first fields only when it is done."""

    id: str
    name: str
    run: str
    state: RunState
    sentence: str
    progress: Progress | None
    form_pv_nm: float | None = None
    form_rms_nm: float | None = None
    spikes: int | None = None
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
    correction: str | None = Field(default=None, description="The last run that corrects by it.")
    predicted: dict[str, Any] | None = Field(
        default=None, description="What is left by prediction, by simulation alone, and which tolerances it misses."
    )


class Causes(Model):
    """What a correction takes into account."""

    causes: Annotated[list[Annotated[str, MaxLen(60)]], MaxLen(40)]
