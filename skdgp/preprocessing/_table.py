"""Base class of the transformers of flight tables: columns by name, others pass through."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod

import numpy as np
import pandas as pd
from sklearn import get_config
from sklearn.base import BaseEstimator, TransformerMixin, _fit_context
from sklearn.utils.validation import _check_feature_names_in, check_is_fitted, validate_data

from skdgp._compute.callbacks import CallbackSupportMixin, FitTask
from skdgp._flight.channels import CHANNELS
from skdgp._flight.checks import check_table


class TableTransformer(CallbackSupportMixin, TransformerMixin, BaseEstimator, ABC, auto_wrap_output_keys=None):
    """Base of transformers that read named columns of a flight table and add or choose others.

    A table may hold any other columns, in any order, and other ones at ``transform`` than at ``fit``: only those
    that the transformer reads must be there. An array, or a table without any known name, passes through unchanged
    with a warning, since its columns cannot be recognised.
    """

    _known = frozenset(CHANNELS)
    in_simulation = "measurements"  # see skdgp.dynamics.as_aerodynamics

    @_fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y=None):
        """Learn which columns are there.

        Parameters
        ----------
        X : DataFrame of shape (n, n_columns)
            Flight table.
        y : None
            Ignored.

        Returns
        -------
        self
        """
        task, self._passes = FitTask(self, X, y), not self._recognises(X)
        if self._passes:
            self._checked_stranger(X, reset=True)
            warnings.warn(
                f"{type(self).__name__} got a table without column names that it knows, so it passes it through "
                "unchanged. Give a DataFrame with the names of docs/notation.md (skdgp.io.read_flight makes one).",
                UserWarning,
                stacklevel=2,
            )
        else:
            check_table(X)
            validate_data(self, X, skip_check_array=True)
            self._fit_table(X)
        task.end()
        return self

    def transform(self, X):
        """Return the table with this step done.

        Parameters
        ----------
        X : DataFrame of shape (n, n_columns)
            Flight table.

        Returns
        -------
        DataFrame or ndarray
            A DataFrame for a DataFrame, with its index.
        """
        check_is_fitted(self)
        if self._passes:
            return self._contained(self._checked_stranger(X))
        return self._contained(self._transform_table(self._as_table(X)))

    def get_feature_names_out(self, input_features=None) -> np.ndarray:
        """Return the column names that ``transform`` gives for the table seen in ``fit``.

        Parameters
        ----------
        input_features : array-like of str, optional
            Must equal ``feature_names_in_`` where that is known.

        Returns
        -------
        ndarray of str objects
        """
        check_is_fitted(self)
        names = _check_feature_names_in(self, input_features)
        return names if self._passes else np.asarray(self._columns_out(list(names)), dtype=object)

    def set_output(self, *, transform=None):
        """Choose the container of ``transform``.

        Parameters
        ----------
        transform : {"default", "pandas", "polars"}, optional
            None leaves the choice as it is.

        Returns
        -------
        self
        """
        if transform not in (None, "default", "pandas", "polars"):
            raise ValueError(f"Got transform={transform!r}, but expected 'default', 'pandas' or 'polars'.")
        if transform is not None:
            self._sklearn_output_config = {"transform": transform}
        return self

    @abstractmethod
    def _fit_table(self, table: pd.DataFrame) -> None:
        """Check the table's columns and learn from them."""

    @abstractmethod
    def _transform_table(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the new table; never writes into the given one."""

    @abstractmethod
    def _columns_out(self, names: list[str]) -> list[str]:
        """Return the columns that come out for those that go in."""

    def _recognises(self, X) -> bool:
        return any(isinstance(name, str) and name in self._known for name in getattr(X, "columns", ()))

    def _as_table(self, X) -> pd.DataFrame:
        if self._recognises(X):
            return check_table(X)
        array = validate_data(self, X, reset=False, ensure_all_finite=False)
        return pd.DataFrame(array, columns=self.feature_names_in_, index=getattr(X, "index", None))

    def _checked_stranger(self, X, *, reset=False):
        named = isinstance(X, pd.DataFrame)
        checked = validate_data(self, X, reset=reset, ensure_all_finite=False, skip_check_array=named)
        return X if named else checked

    def _contained(self, result):
        choice = getattr(self, "_sklearn_output_config", {}).get("transform", get_config()["transform_output"])
        if choice == "default":
            return result
        if not isinstance(result, pd.DataFrame):
            result = pd.DataFrame(result, columns=self.get_feature_names_out())
        if choice == "pandas":
            return result
        import polars

        return polars.DataFrame({name: result[name].to_numpy() for name in result.columns})

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags


def numeric(table: pd.DataFrame, columns) -> np.ndarray:
    """Return columns as floats (n, k); say which one is not made of numbers."""
    columns = list(columns)
    try:
        return table[columns].to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError):
        kinds = {name: str(table[name].dtype) for name in columns if not pd.api.types.is_numeric_dtype(table[name])}
        raise ValueError(f"Got columns of type {kinds}, but expected numbers: convert or drop them.") from None


def with_columns(table: pd.DataFrame, new: dict[str, np.ndarray]) -> pd.DataFrame:
    """Return the table with columns replaced in their place or added at the end."""
    kept = table.assign(**{name: values for name, values in new.items() if name in table})
    added = {name: values for name, values in new.items() if name not in table}
    return pd.concat([kept, pd.DataFrame(added, index=table.index)], axis=1) if added else kept
