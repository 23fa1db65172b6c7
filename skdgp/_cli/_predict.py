"""The command ``predict``: coefficients of flights, with standard deviations."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from skdgp._cli._model import read_flights, read_model
from skdgp._cli._task import Task
from skdgp._cli._writers import check_writable, table_writer
from skdgp.identification import predict_flight


def predict(task: Task) -> None:
    """Write what a model says of flights, row by row."""
    options = task.options
    output = Path(options.output)
    check_writable(output.suffix)
    if output.resolve() in (Path(flight).resolve() for flight in options.flight):
        raise FileExistsError(f"Got {options.output} as the output, but it is one of the flights: name another.")
    task.console.stage("reading")
    model = read_model(options)
    flights = read_flights(options.flight, model, options)
    tables = []
    for name, table in flights.items():
        task.console.stage(f"predicting {name}")
        tables.append(predictions(model.pipeline, table, include_noise=options.include_noise))
    whole = pd.concat(tables, ignore_index=True)
    task.write({output.name: table_writer(whole, output.suffix)})
    task.say(*_summary(whole, flights, options))


def predictions(pipeline, table: pd.DataFrame, *, include_noise: bool) -> pd.DataFrame:
    """Return the coefficients of a flight and their standard deviations, ``CX`` and ``CX_std``, beside its time."""
    mean, std = predict_flight(pipeline, table, include_noise=include_noise)
    names = pipeline[-1].output_names_
    found = dict(zip(names, mean.T, strict=True))
    found |= {f"{name}_std": column for name, column in zip(names, std.T, strict=True)}
    return table[["flight", "time"]].reset_index(drop=True).assign(**found)


def _summary(whole, flights, options) -> tuple[str, dict]:
    names = [name.removesuffix("_std") for name in whole if name.endswith("_std")]
    numbers = {
        "model": options.model,
        "output": options.output,
        "flights": {name: len(table) for name, table in flights.items()},
        "include_noise": options.include_noise,
        "coefficients": {
            name: {
                "lowest": whole[name].min(),
                "highest": whole[name].max(),
                "median_std": whole[f"{name}_std"].median(),
            }
            for name in names
        },
    }
    lines = [f"{rows} rows of flight {name}" for name, rows in numbers["flights"].items()]
    lines += ["", f"{'':6}{'lowest':>12}{'highest':>12}{'std (median)':>15}"]
    for name, row in numbers["coefficients"].items():
        lines.append(f"{name:6}{row['lowest']:>12.4g}{row['highest']:>12.4g}{row['median_std']:>15.2g}")
    return "\n".join([*lines, "", f"table    {options.output}"]), numbers
