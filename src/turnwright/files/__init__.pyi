from .codev import (
    read_zernikes as read_zernikes,
    write_zernikes as write_zernikes,
)
from .lens import (
    LensFile as LensFile,
    LensPhase as LensPhase,
    LensSide as LensSide,
    LensSurface as LensSurface,
)
from .lens_files import (
    read_lens as read_lens,
)
from .read import (
    read_map as read_map,
)
from .slices import (
    read_profile as read_profile,
)
from .write import (
    write_grid_sag as write_grid_sag,
    write_map as write_map,
)
