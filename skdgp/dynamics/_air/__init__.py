"""The air that an aircraft flies in: wind, gusts, density."""
