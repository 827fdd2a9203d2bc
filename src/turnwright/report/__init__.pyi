from .archive import (
    archive_comparison as archive_comparison,
    archive_correction as archive_correction,
    archive_diagnosis as archive_diagnosis,
    archive_measured as archive_measured,
    archive_optics as archive_optics,
    archive_run as archive_run,
    archive_tiled as archive_tiled,
    read_maps as read_maps,
    write_maps as write_maps,
)
from .certificate import (
    write_certificate as write_certificate,
)
from .comparison import (
    draw_candidate as draw_candidate,
    write_comparison as write_comparison,
)
from .drawing import (
    draw_apart as draw_apart,
)
from .figures import (
    write_fit_picture as write_fit_picture,
    write_picture as write_picture,
)
from .lens import (
    write_lens_picture as write_lens_picture,
)
from .measurement import (
    write_correction as write_correction,
    write_diagnosis as write_diagnosis,
    write_measured as write_measured,
)
from .optics import (
    optics_facts as optics_facts,
    write_optics as write_optics,
)
from .page import (
    write_page as write_page,
)
from .run import (
    compose_report as compose_report,
    draw_ahead as draw_ahead,
    write_backplot as write_backplot,
    write_report as write_report,
)
from .study import (
    write_study as write_study,
)
from .tiled import (
    write_tiled as write_tiled,
)
from .tolerance import (
    write_tolerance as write_tolerance,
)
