"""Jobs: the data of a job file, and the functions that plan, run, measure and correct it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
