"""Estimation of material coefficients from forces: records, signals, experiments and fits."""
