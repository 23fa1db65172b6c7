"""FlightReadError, the one error of the readers."""


class FlightReadError(ValueError):
    """A file could not be read as a flight: what was got, what was expected, what to do."""
