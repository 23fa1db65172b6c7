"""Predicted coefficients integrated to states."""
