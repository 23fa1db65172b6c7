"""Models in the formats of other tools."""

from skdgp.export._build_up import BuildUp, Table, build_up

__all__ = ["BuildUp", "Table", "build_up"]
