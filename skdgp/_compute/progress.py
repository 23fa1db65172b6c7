"""Progress of a fit: listeners, and scikit-learn's callbacks (version 1.9 and newer)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Lock
from typing import Any, TypeAlias

from skdgp._compute.sklearn_compat import (
    HAS_CALLBACKS,
    CallbackSupportMixin,
    callback_context,
    has_callbacks,
)

__all__ = ["CallbackSupportMixin", "FitTask", "listening", "notify"]

ROUND = 10  # evaluations that one progress bar stands for
ROUND_NAMES = {"fit": "log likelihood", "members": "log likelihood of a part"}
Listener: TypeAlias = Callable[[str, int, float], Any]

_listener: ContextVar[Listener | None] = ContextVar("skdgp_progress", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    It is called after every evaluation of the likelihood. ``stage`` is "output 1", ... where each
    output is fitted alone, side by side, "fit" where all are fitted together, "members" where parts
    of an average learn their noise; ``n_evaluations`` counts those of a stage; ``log_likelihood``
    is the best so far. What it raises reaches the fit: KeyboardInterrupt ends the search as Ctrl-C
    does, with the best so far. Fits in other processes do not call it.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor, listening
    >>> x, calls = np.linspace(0.0, 6.0, 40)[:, None], []
    >>> with listening(lambda stage, n_evaluations, log_likelihood: calls.append((stage, n_evaluations))):
    ...     model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
    >>> calls[0], len(calls) == model.n_evaluations_
    (('fit', 1), True)
    """
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def notify(stage: str, n_evaluations: int = 0, log_likelihood: float = float("nan")) -> None:
    """Call the listener, if there is one; of a stage that has no evaluations, with 0 and NaN."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)


class FitTask:
    """One fit as a task of scikit-learn's callbacks, which begins when this is made.

    Its subtasks are each output alone, and rounds of ten evaluations of all outputs together, named
    after the log likelihood at their begin. The end of each evaluation passes ``metadata``:
    ``stage``, ``n_evaluations`` (of the whole fit) and ``log_likelihood`` (the best so far of this
    stage). A callback that returns True ends the search as Ctrl-C does.
    """

    def __init__(self, estimator: CallbackSupportMixin, X: Any, y: Any = None):
        self.estimator, self.data, self.lock = estimator, {"X": X, "y": y}, Lock()
        self.n_evaluations, self.n_left, self.stage = 0, 0, ""
        self.round: Any = None  # context of the current subtask
        if HAS_CALLBACKS:
            self.task = callback_context(estimator)
            self._begin(self.task)

    def run(self, function: Callable, *args: Any) -> Any:
        """Return ``function(*args)``, and pass every evaluation in it to the callbacks, if there are any."""
        if not has_callbacks(self.estimator):
            return function(*args)
        outer = _listener.get()

        def notify_both(*progress):
            if outer is not None:
                outer(*progress)
            self._pass_evaluation(*progress)

        with listening(notify_both):
            result = function(*args)
        self._end_round()
        return result

    def end(self) -> None:
        """End the task: the estimator is fitted."""
        if HAS_CALLBACKS:
            self._end(self.task, reconstruction_attributes=dict)

    def _pass_evaluation(self, stage, n_evaluations, log_likelihood):
        with self.lock:  # outputs are fitted side by side
            stage = "outputs" if stage.startswith("output") else stage
            if stage != self.stage or self.n_left == 0:
                self._end_round()
                self._begin_round(stage, log_likelihood)
            self.n_left -= 1
            self.n_evaluations += 1
            metadata = {
                "stage": stage,
                "n_evaluations": self.n_evaluations,
                "log_likelihood": log_likelihood,
            }
            evaluation = self.round.subcontext(task_name=f"evaluation {self.n_evaluations}")
            self._begin(evaluation)
            if self._end(evaluation, metadata=metadata):
                raise KeyboardInterrupt

    def _begin_round(self, stage, log_likelihood):
        alone = stage == "outputs"
        name = "each output alone" if alone else f"{ROUND_NAMES[stage]} {log_likelihood:.1f}"
        self.stage, self.n_left = stage, -1 if alone else ROUND
        self.round = self.task.subcontext(task_name=name, max_subtasks=None if alone else ROUND)
        self._begin(self.round)

    def _end_round(self):
        if self.round is not None:
            self._end(self.round)
            self.round = None

    def _begin(self, task):
        task.call_on_fit_task_begin(estimator=self.estimator, **self.data)

    def _end(self, task, **facts):
        return task.call_on_fit_task_end(estimator=self.estimator, **self.data, **facts)
