"""Trim, linear models, stability derivatives."""
