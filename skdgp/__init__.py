"""Aircraft aerodynamics from flight logs with dependent Gaussian processes, as ordinary scikit-learn."""

from importlib import import_module
from typing import TYPE_CHECKING

# isort: off
if TYPE_CHECKING:
    from skdgp import (
        control as control,
        datasets as datasets,
        design as design,
        dynamics as dynamics,
        estimation as estimation,
        export as export,
        identification as identification,
        inference as inference,
        io as io,
        kernels as kernels,
        metrics as metrics,
        model_selection as model_selection,
        plotting as plotting,
        preprocessing as preprocessing,
        report as report,
    )
    from skdgp._compute.messages import listening as listening
    from skdgp._regressor import (
        DependentGPRegressor as DependentGPRegressor,
        FewRowsWarning as FewRowsWarning,
    )
    from skdgp.identification import make_identification_pipeline as make_identification_pipeline

# isort: on

__all__ = [
    "DependentGPRegressor",
    "FewRowsWarning",
    "listening",
    "make_identification_pipeline",
]
__version__ = "0.1.0"

_HOMES = {
    "DependentGPRegressor": "_regressor",
    "FewRowsWarning": "_regressor",
    "listening": "_compute.messages",
    "make_identification_pipeline": "identification",
}
_FOLDERS = [
    "control",
    "datasets",
    "design",
    "dynamics",
    "estimation",
    "export",
    "identification",
    "inference",
    "io",
    "kernels",
    "metrics",
    "model_selection",
    "plotting",
    "preprocessing",
    "report",
]


def __getattr__(name: str) -> object:
    """Import a name when it is asked for, so that the command line starts, and can be stopped, at once."""
    if name in _HOMES:
        return getattr(import_module(f"skdgp.{_HOMES[name]}"), name)
    if name in _FOLDERS:
        return import_module(f"skdgp.{name}")
    raise AttributeError(f"module 'skdgp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__, *_FOLDERS]
