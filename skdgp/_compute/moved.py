"""Modules that have moved: model files of earlier versions name them by their old paths."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec

MOVED = {
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
        return ModuleSpec(name, MovedModules) if name in MOVED else None

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
