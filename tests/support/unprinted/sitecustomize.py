"""Leave out the printing of the figures of reports: a third of the time of a small run.

Python imports this as it starts, in processes of tests whose `PYTHONPATH` names this folder.
"""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder


class Unprinted(MetaPathFinder):
    """Finds the module of figures, and replaces its printing once it is imported."""

    def find_spec(self, fullname, path, target=None):
        if fullname != "turnwright.report.figures":
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            module._print_svg = lambda _canvas: "<svg></svg>"

        spec.loader.exec_module = exec_module
        return spec


sys.meta_path.insert(0, Unprinted())
