"""NC programs: writing, reading back, and reading programs of other origin."""

from turnwright.post.approach import (
    GAP,
    MOST_CLEARANCE,
    PLUNGE_FEED,
    Approach,
    entry_path,
    entry_shares,
    entry_words,
    plan_approach,
)
from turnwright.post.checking import DialectCheck, check_dialect
from turnwright.post.dialect import Dialect, dialect_of
from turnwright.post.header import (
    ProgramHeader,
    ProgramInfo,
    ProgramPass,
    ProgramStart,
    ProgramWarning,
    ToolChange,
    WorkOffset,
    inspect_nc,
    stop_instructions,
)
from turnwright.post.reader import Move, ProgramCut, read_cut_and_moves, read_moves, read_nc
from turnwright.post.spindle import require_spindle_modes
from turnwright.post.sync import FastToolFiles, read_fast_tool, write_fast_tool
from turnwright.post.table import read_table
from turnwright.post.writer import FASTEST_PLUNGE, ProgramFiles, write_nc

__all__ = [
    "FASTEST_PLUNGE",
    "GAP",
    "MOST_CLEARANCE",
    "PLUNGE_FEED",
    "Approach",
    "Dialect",
    "DialectCheck",
    "FastToolFiles",
    "Move",
    "ProgramCut",
    "ProgramFiles",
    "ProgramHeader",
    "ProgramInfo",
    "ProgramPass",
    "ProgramStart",
    "ProgramWarning",
    "ToolChange",
    "WorkOffset",
    "check_dialect",
    "dialect_of",
    "entry_path",
    "entry_shares",
    "entry_words",
    "inspect_nc",
    "plan_approach",
    "read_cut_and_moves",
    "read_fast_tool",
    "read_moves",
    "read_nc",
    "read_table",
    "require_spindle_modes",
    "stop_instructions",
    "write_fast_tool",
    "write_nc",
]
