"""Support for scikit-learn's callbacks (version 1.9 and newer)."""

from __future__ import annotations

from threading import Lock

from skdgp._compute.progress import listening_too
from skdgp._compute.sklearn_compat import HAS_CALLBACKS, CallbackSupportMixin, callback_context, has_callbacks

__all__ = ["CallbackSupportMixin", "FitTask"]

ROUND = 10  # evaluations that one bar stands for
WORDS = {"fit": "log likelihood", "bound": "inducing inputs, bound"}


class FitTask:
    """One fit as scikit-learn's callbacks see it: a task, which begins when this is made.

    Within it each output alone is a task, and so are rounds of ten evaluations of all outputs together, named after
    the log likelihood where they begin. In these each evaluation is one; at its end callbacks that ask for ``metadata``
    get ``stage``, ``n_evaluations`` (of the whole fit) and ``log_likelihood`` (the best so far of this stage). A
    callback that answers True ends the search as Ctrl-C does.

    Parameters
    ----------
    estimator : CallbackSupportMixin
        Being fitted.
    X, y
        What it is fitted to.
    """

    def __init__(self, estimator, X, y=None):
        self.estimator, self.data, self.lock = estimator, {"X": X, "y": y}, Lock()
        self.n_evaluations, self.stage, self.round, self.left = 0, None, None, 0
        if HAS_CALLBACKS:
            self.task = callback_context(estimator)
            self._begin(self.task)

    def heard(self, function, *args):
        """Return ``function(*args)``, every evaluation in it told to the callbacks, if there are any."""
        if not has_callbacks(self.estimator):
            return function(*args)
        with listening_too(self._hear):
            result = function(*args)
        self._end_round()
        return result

    def end(self):
        """Tell the callbacks that the estimator is fitted."""
        if HAS_CALLBACKS:
            self._end(self.task, reconstruction_attributes=dict)

    def _hear(self, stage, n_evaluations, log_likelihood):
        with self.lock:  # outputs are fitted side by side
            stage = "outputs" if stage.startswith("output") else stage
            if stage != self.stage or self.left == 0:
                self._end_round()
                self._begin_round(stage, log_likelihood)
            self.left -= 1
            self.n_evaluations += 1
            news = {"stage": stage, "n_evaluations": self.n_evaluations, "log_likelihood": log_likelihood}
            evaluation = self.round.subcontext(task_name=f"evaluation {self.n_evaluations}")
            self._begin(evaluation)
            if self._end(evaluation, metadata=news):
                raise KeyboardInterrupt

    def _begin_round(self, stage, log_likelihood):
        alone = stage == "outputs"
        name = "each output alone" if alone else f"{WORDS[stage]} {log_likelihood:.1f}"
        self.stage, self.left = stage, -1 if alone else ROUND
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
