"""Inputs that excite an aircraft, as functions of time; `skdgp.design` shows them to users."""
