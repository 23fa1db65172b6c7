"""The command ``validate``: evaluate a saved model on flights."""

from __future__ import annotations

import warnings

from skdgp._cli._job import finish, try_on
from skdgp._cli._model import loads_of, read_flights, read_model
from skdgp._cli._task import Task
from skdgp.identification._outcome import Outcome, fit_facts


def validate(task: Task) -> None:
    """Compare a model with flights, fly it, and say how it did."""
    options = task.options
    task.console.stage("reading")
    model = read_model(options)
    loads = loads_of(model, options)
    flights = read_flights(options.flight, model, options)
    for name in flights.keys() & set(model.get("flights", [])):
        warnings.warn(
            f"The model learned from a flight {name!r}: if it is this one, its errors say nothing about others.",
            UserWarning,
            stacklevel=2,
        )
    evaluations = try_on(flights, model.pipeline, model.aircraft, loads, task)
    outcome = Outcome(
        title=f"{model.aircraft.name}: a model on other flights",
        command=task.command,
        aircraft=model.aircraft,
        pipeline=model.pipeline,
        loads=loads,
        settings=model.get("options", {}) | loads.keywords() | {"horizons": options.horizons},
        fit=fit_facts(model.pipeline) | model.get("fit", {}),
        train={},
        evaluations=evaluations,
        messages=task.console.messages,
    )
    task.say(*finish(outcome, task))
