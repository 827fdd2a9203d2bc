"""Leave out in a process of tests what costs much and is not their subject, as fixtures do in their own process.

The printing of the figures of reports is a third of the time of a small run. A server keeps one process warm, and a
correction is proved by a quarter of the next parts. Python imports this as it starts, in processes of tests whose
`PYTHONPATH` names this folder.
"""

import os
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder

LESS = {"turnwright.report.figures": {"_print_svg": lambda _canvas: "<svg></svg>"}}
if "TURNWRIGHT_SMALL_SERVER" in os.environ:
    LESS |= {"turnwright.web.workers": {"PLANNERS": 1}, "turnwright.diagnosis.report": {"DRAWS": 50}}


class Less(MetaPathFinder):
    """Finds these modules, and replaces a part of each once it is imported."""

    def find_spec(self, fullname, path, target=None):
        if fullname not in LESS:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            for name, value in LESS[fullname].items():
                setattr(module, name, value)

        spec.loader.exec_module = exec_module
        return spec


sys.meta_path.insert(0, Less())
