"""Modules that have moved: model files of earlier versions name them by their old paths."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec

MOVED = {
    "skdgp.inference._factor": "skdgp.inference._exact",
    "skdgp.inference._paths": "skdgp.inference._posterior_paths",
    "skdgp.inference._readout": "skdgp.inference._sparse",
    "skdgp.inference._samples": "skdgp.inference._sums",
    "skdgp.inference._shares": "skdgp.inference._sums",
    "skdgp.kernels._basis": "skdgp.kernels._trend",
    "skdgp.kernels._parts": "skdgp.kernels._features",
    "skdgp.kernels._paths": "skdgp.kernels._prior_paths",
    "skdgp.preprocessing._reconstruction": "skdgp.preprocessing",  # a folder in version 0.1
    "skdgp.preprocessing._reconstruction.reconstruction": "skdgp.preprocessing._flight_path",
    "skdgp.metrics._point": "skdgp.metrics._metrics",
    "skdgp.metrics._probabilistic": "skdgp.metrics._metrics",
    "skdgp.dynamics._aircraft": "skdgp.dynamics._vehicle.aircraft",
    "skdgp.dynamics._propeller": "skdgp.dynamics._vehicle.engines",
    "skdgp.dynamics._thrust_line": "skdgp.dynamics._vehicle.engines",
    "skdgp.dynamics._vehicle.propeller": "skdgp.dynamics._vehicle.engines",
    "skdgp.dynamics._vehicle.thrust_line": "skdgp.dynamics._vehicle.engines",
    "skdgp.dynamics._vehicle.thrust_table": "skdgp.dynamics._vehicle.engines",
}


class MovedModules:
    """Import a module that has moved when its old path is asked for, as unpickling does."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Return how to load a module that has moved, None for every other name."""
        return ModuleSpec(name, MovedModules) if name in MOVED else None  # type: ignore[arg-type]

    @staticmethod
    def create_module(spec):
        """Return the module at its new place."""
        module = import_module(MOVED[spec.name])
        spec.loader_state = module.__spec__
        return module

    @staticmethod
    def exec_module(module):
        """Leave the module as it ran at its new place."""
        module.__spec__ = module.__spec__.loader_state


sys.meta_path.append(MovedModules)
