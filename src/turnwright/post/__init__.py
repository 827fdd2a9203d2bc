"""Programs on disk: write them, read them back, read other people's."""

from turnwright.post._header import ProgramHeader, ProgramInfo, ProgramPass, ProgramWarning, inspect_nc
from turnwright.post._reader import read_nc
from turnwright.post._registry import dialect_of
from turnwright.post._sync import FastToolFiles, read_fast_tool, write_fast_tool
from turnwright.post._table import read_table
from turnwright.post._writer import ProgramFiles, write_nc

__all__ = [
    "FastToolFiles",
    "ProgramFiles",
    "ProgramHeader",
    "ProgramInfo",
    "ProgramPass",
    "ProgramWarning",
    "dialect_of",
    "inspect_nc",
    "read_fast_tool",
    "read_nc",
    "read_table",
    "write_fast_tool",
    "write_nc",
]
