"""Form, texture and registration of measured height maps."""

from turnwright.metrology.alignment import Alignment
from turnwright.metrology.areal_parameters import Roughness, roughness
from turnwright.metrology.bearing_curve import Bearing, bearing
from turnwright.metrology.best_fits import BestFit, best_fit, interferogram
from turnwright.metrology.call_outs import CallOut, read_call_out, require_consistent
from turnwright.metrology.clean import Filled, OutlierRemoval, crop_to_aperture, fill_holes, remove_outliers, trim_edge
from turnwright.metrology.cusps import Cusps, Stretch, find_cusps
from turnwright.metrology.feature_parameters import Features, features
from turnwright.metrology.filters import Bands, Nesting, filter_map, separate_bands
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import area_rms
from turnwright.metrology.lens_array import Lenslet, Lenslets, base_forms, has_lenslets, lenslets
from turnwright.metrology.map_overview import level, overview
from turnwright.metrology.pose_search import axisymmetric
from turnwright.metrology.profile import line_profile, without_form
from turnwright.metrology.profile_parameters import ProfileRoughness, profile_roughness
from turnwright.metrology.registration import EDGE, DoubtKind, PoseCandidate, Registration, Undetermined, register
from turnwright.metrology.slope import Slopes, slope_error
from turnwright.metrology.smoothing import Smooth, form_compensation, sum_tables
from turnwright.metrology.spectrum import FEWEST, AreaSpectrum, Spectrum, Window, area_psd, line_psd
from turnwright.metrology.tolerances import (
    FormComponents,
    evaluate_call_out,
    form_components,
    noise_doubt,
    pv_doubt,
    require_covered,
)
from turnwright.metrology.tool_edge import EdgeFit, fit_edge, read_edge_trace
from turnwright.metrology.turned_edge import TurnedEdge, edge_from_cusps
from turnwright.metrology.turning import TurningCentre, turning_centre
from turnwright.metrology.zernike_fit import ZernikeFit, fit_zernike

__all__ = [
    "EDGE",
    "FEWEST",
    "Alignment",
    "AreaSpectrum",
    "Bands",
    "Bearing",
    "BestFit",
    "CallOut",
    "Cusps",
    "DoubtKind",
    "EdgeFit",
    "Features",
    "Filled",
    "Form",
    "FormComponents",
    "Lenslet",
    "Lenslets",
    "Nesting",
    "OutlierRemoval",
    "PoseCandidate",
    "ProfileRoughness",
    "Registration",
    "Roughness",
    "Slopes",
    "Smooth",
    "Spectrum",
    "Stretch",
    "TurnedEdge",
    "TurningCentre",
    "Undetermined",
    "Window",
    "ZernikeFit",
    "area_psd",
    "area_rms",
    "axisymmetric",
    "base_forms",
    "bearing",
    "best_fit",
    "crop_to_aperture",
    "edge_from_cusps",
    "evaluate_call_out",
    "features",
    "fill_holes",
    "filter_map",
    "find_cusps",
    "fit_edge",
    "fit_zernike",
    "form_compensation",
    "form_components",
    "has_lenslets",
    "interferogram",
    "lenslets",
    "level",
    "line_profile",
    "line_psd",
    "noise_doubt",
    "overview",
    "profile_roughness",
    "pv_doubt",
    "read_call_out",
    "read_edge_trace",
    "register",
    "remove_form",
    "remove_outliers",
    "require_consistent",
    "require_covered",
    "roughness",
    "separate_bands",
    "slope_error",
    "sum_tables",
    "trim_edge",
    "turning_centre",
    "without_form",
]
