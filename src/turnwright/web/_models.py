"""What goes over the wire as JSON: the words of the OpenAPI schema."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import MaxLen
from pydantic import BaseModel, ConfigDict, Field

__all__ = [
    "About",
    "Check",
    "Data",
    "ExampleJob",
    "ExampleLine",
    "Fault",
    "Limits",
    "Parsed",
    "Preview",
    "Problem",
    "Toml",
    "Written",
]


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

    toml: Annotated[str, MaxLen(8 * 2**20)]


class Data(Model):
    """A job as data: what its file says, quantities as text with units."""

    data: dict[str, Any]


class Question(Data):
    """A job and who asks, so that of several questions of one page only the last is answered."""

    client: Annotated[str, MaxLen(64)] = Field(default="", description="Any text that one page always sends.")


class Parsed(Model):
    """A job file as data."""

    data: dict[str, Any]
    errors: list[Fault]


class ExampleJob(Parsed):
    """An example."""

    toml: str


class Written(Model):
    """A job as a file."""

    toml: str
    errors: list[Fault]


class AccessFinding(Model):
    """One thing that was looked at, see `turnwright.AccessFinding`."""

    name: str
    value: float | None
    limit: float | None
    margin: float | None
    where: tuple[float, float] | None
    ok: bool
    sentence: str


class Access(Model):
    """Whether the tool reaches the part, see `turnwright.Access`."""

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


class Check(Model):
    """What can be said of a job at once."""

    errors: list[Fault]
    access: Access | None
    preview: Preview | None
    chips: dict[str, str]
    warnings: list[str]


RunKind = Literal["run", "compare", "correct", "measure"]
RunState = Literal["queued", "running", "done", "failed", "cancelled"]
