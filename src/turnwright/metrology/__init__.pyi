from .alignment import (
    Alignment as Alignment,
)
from .areal_parameters import (
    Roughness as Roughness,
    roughness as roughness,
)
from .bearing_curve import (
    Bearing as Bearing,
    bearing as bearing,
)
from .best_fits import (
    BestFit as BestFit,
    best_fit as best_fit,
    interferogram as interferogram,
)
from .call_outs import (
    CallOut as CallOut,
    read_call_out as read_call_out,
    require_consistent as require_consistent,
)
from .clean import (
    Filled as Filled,
    OutlierRemoval as OutlierRemoval,
    crop_to_aperture as crop_to_aperture,
    fill_holes as fill_holes,
    remove_outliers as remove_outliers,
    trim_edge as trim_edge,
)
from .cusps import (
    Cusps as Cusps,
    Stretch as Stretch,
    find_cusps as find_cusps,
)
from .feature_parameters import (
    Features as Features,
    features as features,
)
from .filters import (
    Bands as Bands,
    Nesting as Nesting,
    filter_map as filter_map,
    separate_bands as separate_bands,
)
from .form import (
    Form as Form,
    remove_form as remove_form,
)
from .grid import (
    area_rms as area_rms,
)
from .lens_array import (
    Lenslet as Lenslet,
    Lenslets as Lenslets,
    base_forms as base_forms,
    has_lenslets as has_lenslets,
    lenslets as lenslets,
)
from .map_overview import (
    level as level,
    overview as overview,
)
from .pose_search import (
    axisymmetric as axisymmetric,
)
from .profile import (
    line_profile as line_profile,
    without_form as without_form,
)
from .profile_parameters import (
    ProfileRoughness as ProfileRoughness,
    profile_roughness as profile_roughness,
)
from .registration import (
    EDGE as EDGE,
    DoubtKind as DoubtKind,
    PoseCandidate as PoseCandidate,
    Registration as Registration,
    Undetermined as Undetermined,
    register as register,
)
from .slope import (
    Slopes as Slopes,
    slope_error as slope_error,
)
from .smoothing import (
    Smooth as Smooth,
    form_compensation as form_compensation,
    sum_tables as sum_tables,
)
from .spectrum import (
    FEWEST as FEWEST,
    AreaSpectrum as AreaSpectrum,
    Spectrum as Spectrum,
    Window as Window,
    area_psd as area_psd,
    line_psd as line_psd,
)
from .tolerances import (
    FormComponents as FormComponents,
    evaluate_call_out as evaluate_call_out,
    form_components as form_components,
    noise_doubt as noise_doubt,
    pv_doubt as pv_doubt,
    require_covered as require_covered,
)
from .tool_edge import (
    EdgeFit as EdgeFit,
    fit_edge as fit_edge,
    read_edge_trace as read_edge_trace,
)
from .turned_edge import (
    TurnedEdge as TurnedEdge,
    edge_from_cusps as edge_from_cusps,
)
from .turning import (
    TurningCentre as TurningCentre,
    turning_centre as turning_centre,
)
from .zernike_fit import (
    ZernikeFit as ZernikeFit,
    fit_zernike as fit_zernike,
)
