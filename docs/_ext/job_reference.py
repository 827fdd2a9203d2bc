"""Writes the page of every table and key of a job file, from the classes that read it, before the pages are read."""

from pathlib import Path

from turnwright.job import reference_tables

HEAD = """# Every key of a job file

Every table and key of a job file. Quantities are text with a unit (`"8 um/rev"`); a bare number is refused where a unit
is needed. Keys in **bold** must be stated. `turnwright new sphere --out my_job.toml` writes a file to start from, with
the same explanations. This page is generated from the classes that read the file.

"""


def page() -> str:
    """Return the page as Markdown."""
    lines = [HEAD]
    for table in reference_tables():
        named = next((key.line for key in table.keys if key.name in ("family", "kind")), "")
        brackets = f"[[{table.place}]]" if table.place in ("passes", "simulation.patches") else f"[{table.place}]"
        lines += [f"## `{brackets}`" + (f", `{named}`" if named else ""), "", table.text, ""]
        lines += ["| key | type | limits | default | what it is | example |", "|---|---|---|---|---|---|"]
        for key in table.keys:
            name = f"**`{key.name}`**" if key.required else f"`{key.name}`"
            cells = [name, key.takes, key.limits, f"`{key.default}`" if key.default else "", key.text]
            cells.append(f"`{key.line}`" if key.line else "")
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines)


def _write(app: object) -> None:
    file = Path(app.srcdir) / "job_file_reference.md"
    if not file.is_file() or file.read_text(encoding="utf-8") != page():
        file.write_text(page(), encoding="utf-8")


def setup(app: object) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
