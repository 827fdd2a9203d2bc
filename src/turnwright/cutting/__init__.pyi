from .chip import (
    ChipMap as ChipMap,
    OrthogonalChip as OrthogonalChip,
    RoundChip as RoundChip,
    chip_map as chip_map,
    expected_thickest as expected_thickest,
)
from .ductile_check import (
    DuctileCheck as DuctileCheck,
    check_ductile as check_ductile,
    predict_chips as predict_chips,
)
from .finish import (
    MinimumChip as MinimumChip,
    Vibration as Vibration,
    add_vibration as add_vibration,
    cusp_height as cusp_height,
    predict_uncut_height as predict_uncut_height,
)
from .forces import (
    CuttingForces as CuttingForces,
    FlyCut as FlyCut,
    ForceHistory as ForceHistory,
    SlotMill as SlotMill,
    chip_forces as chip_forces,
)
from .fracture import (
    IntactShare as IntactShare,
    ri80 as ri80,
)
from .learning.cuts import (
    Cuts as Cuts,
    InterruptedCuts as InterruptedCuts,
    NoseCuts as NoseCuts,
    interrupted_cuts as interrupted_cuts,
    measured_cuts as measured_cuts,
    turning_cuts as turning_cuts,
)
from .learning.dynamometer import (
    Dynamometer as Dynamometer,
    TapTest as TapTest,
)
from .learning.experiment import (
    Experiment as Experiment,
    learn_from_file as learn_from_file,
)
from .learning.material_fit import (
    learn_material as learn_material,
)
from .learning.records import (
    read_forces as read_forces,
)
from .learning.results import (
    Estimate as Estimate,
    ForceFit as ForceFit,
    LearnedMaterial as LearnedMaterial,
)
from .learning.signals import (
    ForceAverage as ForceAverage,
    ForceRecord as ForceRecord,
    average_force as average_force,
    engagements as engagements,
    in_air as in_air,
    low_pass as low_pass,
    remove_drift as remove_drift,
)
