from .diagnosing import (
    diagnose as diagnose,
    plausible_rms_nm as plausible_rms_nm,
)
from .error_sources import (
    DEFAULT as DEFAULT,
    ERROR_SOURCES as ERROR_SOURCES,
    ErrorSource as ErrorSource,
)
from .findings import (
    Contribution as Contribution,
    Diagnosis as Diagnosis,
    DrawnCut as DrawnCut,
    Draws as Draws,
    Finding as Finding,
)
from .map_points import (
    FREE as FREE,
)
from .proof import (
    Proof as Proof,
    prove as prove,
)
from .setup import (
    CentreDefect as CentreDefect,
    Move as Move,
    centre_defect as centre_defect,
    handbook_offset as handbook_offset,
    moves as moves,
)
