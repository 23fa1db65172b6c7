"""The command ``export``: a model in a form that other programs read."""

from __future__ import annotations

import shutil
import tempfile
from functools import partial
from pathlib import Path

from skdgp._cli import _options as opt
from skdgp._cli._output import Run
from skdgp._cli._predict import read_model
from skdgp.export import FORMATS, export_model, load_portable


def export(run: Run) -> None:
    """Write a model in a form that other programs read, without Python or without pickle.

    portable  model.npz: arrays and JSON, no code; skdgp.export.load_portable and examples/read_portable.py read it
    c         aero.h, aero.c: mean, deviation, slopes and limits in C99; "make test" compares them with the model
    jsbsim    aircraft/NAME/NAME.xml: an aircraft whose coefficients are the sums of their effects
    casadi    aero.casadi: mean, deviation and Jacobian as a Function, for optimisation; needs CasADi
    onnx      aero.onnx: mean and deviation as a graph, for inference runtimes; needs ONNX

    MODEL is the model.joblib that identify wrote, or a model.npz. With --max-kb the model gets
    fewer basis functions; the loss is printed in standard deviations of the posterior. All files
    are written into DIR, or none.

    For example:
      skdgp export results/model.joblib --to portable -o portable
      skdgp export results/model.joblib --to c --max-kb 256 -o flight_code
    """
    options = run.options
    run.console.stage("reading")
    if Path(options.model).suffix != ".npz":
        model = read_model(options)
    elif options.aircraft is not None:
        raise ValueError(
            "Got --aircraft with a portable model, but expected model.joblib: a portable model "
            "has its own."
        )
    else:
        model = load_portable(options.model)
    run.console.stage(f"exporting to {options.to}")
    with tempfile.TemporaryDirectory(dir=run.folder.path if run.folder else None) as temporary:
        facts = export_model(temporary, model, options.to, max_kb=options.max_kb)
        files = {str(Path(path).relative_to(temporary)): Path(path) for path in facts["files"]}
        sizes = {name: path.stat().st_size for name, path in files.items()}
        for name in files:
            Path(options.output, name).parent.mkdir(parents=True, exist_ok=True)
        run.write({name: partial(shutil.copyfile, path) for name, path in files.items()})
    numbers = {"model": options.model, "to": options.to, **facts, "files": sizes}
    run.print(_text(options.output, numbers), numbers)


def _text(folder, numbers) -> str:
    width = max(map(len, numbers["files"])) + 2
    lines = [f"{name:<{width}}{size / 1024:>9.1f} kB" for name, size in numbers["files"].items()]
    if loss := numbers.get("loss"):
        lines += ["", "loss, root mean square, in posterior deviations"]
        lines += [f"{'':6}{'mean':>12}{'std':>12}"]
        lines += [f"{name:6}{row['mean']:>12.2g}{row['std']:>12.2g}" for name, row in loss.items()]
    return "\n".join([*lines, "", f"written into {folder}"])


COMMANDS: opt.Commands = {
    export: {
        "": {
            "model": opt.SHARED["model"]
            | {
                "help": f"the model.joblib that identify wrote ({opt.TRUST}), or a portable model.npz"
            },
            "--aircraft": opt.SHARED["--aircraft"],
            "--output": opt.SHARED["--output"] | {"required": True},
            "--to": {"choices": list(FORMATS), "required": True, "help": "the format"},
            "--max-kb": {
                "metavar": "KB",
                "type": opt.positive("kB"),
                "help": "largest size of the code, or of the portable form (default: whole model)",
            },
        },
    },
}
