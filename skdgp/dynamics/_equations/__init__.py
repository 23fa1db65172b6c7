"""Equations of motion and aerodynamics."""
