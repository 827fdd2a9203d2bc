"""Reading and writing measured maps, one module per file format; reading lens files.

A reader takes the path and the bytes of a file and returns a `turnwright.HeightMap` in mm, rows ascending in y.
To add a format, add a module here and a line to ``read.py`` (its signature) or ``write.py`` (its name).

Sizes stated in a file are compared with its length before memory is allocated. Every failure is a
`turnwright.errors.MapError` of one sentence. Lens files are read by ``zemax_lens.py`` and ``codev_lens.py`` into
the classes of ``lens.py``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
