"""Aircraft aerodynamics from flight logs with dependent Gaussian processes, as ordinary scikit-learn."""

from importlib import import_module

__all__ = [
    *("DependentGPRegressor", "Effects", "FewRowsWarning", "effects", "listening"),
    "make_identification_pipeline",
]
__version__ = "0.1.0"

_HOMES = {
    "DependentGPRegressor": "_regressor",
    "FewRowsWarning": "_regressor",
    "Effects": "_effects",
    "effects": "_effects",
    "listening": "_compute.progress",
    "make_identification_pipeline": "identification",
}
_FOLDERS = (
    *(
        "calibration",
        "datasets",
        "design",
        "dynamics",
        "export",
        "identification",
        "inference",
        "io",
        "kernels",
    ),
    *("metrics", "model_selection", "plotting", "preprocessing", "report"),
)


def __getattr__(name):
    """Import what is asked for: so ``python -m skdgp`` begins at once, and can be stopped while it imports the rest."""
    if name in _HOMES:
        return getattr(import_module(f"skdgp.{_HOMES[name]}"), name)
    if name in _FOLDERS:
        return import_module(f"skdgp.{name}")
    raise AttributeError(f"module 'skdgp' has no attribute {name!r}")


def __dir__():
    return [*globals(), *__all__, *_FOLDERS]
