"""Equations of motion, and the aerodynamics in them."""
