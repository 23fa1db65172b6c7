"""Logs of autopilots: PX4 ULog and ArduPilot DataFlash."""
