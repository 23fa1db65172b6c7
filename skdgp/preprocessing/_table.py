"""Base class of the transformers of flight tables, and operations on their columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Iterable
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._compute.sklearn_compat import check_feature_names_in, fit_context
from skdgp._flight.tables import FlightTable, check_table


class TableTransformer(TransformerMixin, BaseEstimator, ABC):
    """Base of transformers that read named columns of a flight table and add or choose others.

    Only the columns that the transformer reads must be present, in any order; others pass through,
    and may differ between ``fit`` and ``transform``. ``fit`` raises TypeError at an array, and
    ValueError at a table without any of the columns that the transformer works on.
    """

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: Any, y: Any = None) -> Self:
        """Check the columns of the flight table X, and learn from them; y is ignored."""
        self._fit_table(self._checked(X))
        return self

    def _checked(self, X: Any) -> Any:
        """Return the table of ``fit``, and store the names of its columns."""
        table = self._read(X)
        validate_data(self, as_table(table), skip_check_array=True)
        return table

    def transform(self, X: Any) -> Any:
        """Return the transformed flight table X, with its index."""
        check_is_fitted(self)
        return self._transform_table(self._read(X))

    def _read(self, X: Any) -> Any:
        """Return the table of flights X; raise TypeError if it is none."""
        return check_table(as_table(X))

    def get_feature_names_out(self, input_features: Any = None) -> np.ndarray:
        """Return the column names of the transformed table; ``input_features`` must equal ``feature_names_in_``."""
        check_is_fitted(self)
        names = check_feature_names_in(self, input_features)
        return np.asarray(self._columns_out(list(names)), dtype=object)

    def in_simulation(self) -> dict[str, Any]:
        """Return the parameters of `skdgp.dynamics.Aerodynamics` that it knows; none if it treats measurements."""
        return {}

    @abstractmethod
    def _fit_table(self, table: pd.DataFrame) -> Any:
        """Check the table's columns and learn from them."""

    @abstractmethod
    def _transform_table(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the new table, without changing the given one."""

    def _columns_out(self, names: list[str]) -> list[str]:
        """Return the columns of the transformed table for given ones; by default the same."""
        return names

    def _check_any(self, table: pd.DataFrame, names: Iterable[str]) -> None:
        """Raise ValueError if the table has none of the columns that the transformer works on."""
        names = list(names)
        if not present(names, table):
            raise ValueError(
                f"Got a table with the columns {[*map(str, table.columns[:20])]}, but "
                f"{type(self).__name__} expected at least one of {names}. Rename yours; "
                f"docs/notation.md lists every name with its unit."
            )

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        tags.input_tags.two_d_array = False  # columns are found by their names
        return tags


def as_table(X: Any) -> Any:
    """Return the table of checked flights; other input as it is."""
    return X.table if isinstance(X, FlightTable) else X


def present(names: Iterable[str], columns: Container[str]) -> list[str]:
    """Return the names that are among the columns, in their order."""
    return [name for name in names if name in columns]


def with_names(names: Iterable[str], added: Iterable[str]) -> list[str]:
    """Return the names followed by the added ones that are new."""
    return list(dict.fromkeys([*names, *added]))
