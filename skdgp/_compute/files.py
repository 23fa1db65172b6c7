"""Files, written whole or not at all; JSON and TOML with one-line errors; tables and CSV; versions of software."""

from __future__ import annotations

import json
import math
import os
import platform
import secrets
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd

from skdgp._compute.findings import Finding, Kind

Writer: TypeAlias = "Callable[[Path], object]"  # fills a file


def write_atomically(path: str | os.PathLike[str], write: Writer) -> Path:
    """Let ``write(temporary)`` fill a file beside ``path``, put it in place in one step, and return ``path``.

    A reader sees the old file or the complete new one. If ``write`` fails or is interrupted, the
    temporary file is removed and an earlier file stays as it was. A symbolic link is followed, not
    replaced. Its folder is made. Raises IsADirectoryError for a folder, and OSError with ``path`` if it
    cannot be written.
    """
    path = Path(path)
    target = path.resolve()
    if target.is_dir():
        raise IsADirectoryError(
            f"Got the folder {str(path)!r} as a file to write: name a file inside it."
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    # Not tempfile: its files are readable by their owner alone, and would stay so after the
    # replacement.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(4)}.part{target.suffix}")
    try:
        write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())  # before the rename, or a power cut could leave an empty file
        os.replace(temporary, target)
    except OSError as error:
        if error.filename not in (None, str(temporary)):  # another file's
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_together(folder: Path, writers: dict[str, Writer]) -> None:
    """Write several files: all are complete beside their places before the first is put into its own."""
    if not writers:
        return
    (name, writer), *further = writers.items()

    def write_with_others(temporary):
        writer(temporary)
        write_together(folder, dict(further))

    write_atomically(folder / name, write_with_others)


def text_writer(text: str) -> Writer:
    """Return the writer of a text in UTF-8; bytes of names that are none are escaped."""
    return lambda path: path.write_text(text, encoding="utf-8", errors="backslashreplace")


def plain(value: Any) -> Any:
    """Return a value for JSON: None instead of NaN and infinity, text instead of types that JSON does not have.

    Tables are rows by their index, level by level, records their fields by name.
    """
    if isinstance(value, Finding):
        value = value.to_dict()
    if isinstance(value, Kind):
        return value.label
    if isinstance(value, pd.DataFrame) and value.index.nlevels > 1:
        value = {key: part.droplevel(0) for key, part in value.groupby(level=0, sort=False)}
    if isinstance(value, pd.DataFrame):
        value = value.to_dict("index")
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float) else repr(value)


def without_nones(values: Any) -> dict[str, Any]:
    """Return the values that are not None of a mapping, or of pairs of a name and a value."""
    return {name: value for name, value in dict(values).items() if value is not None}


def json_text(value: Any) -> str:
    """Return a file of JSON."""
    return json.dumps(plain(value), indent=1, allow_nan=False) + "\n"


def read_json(path: str | os.PathLike[str]) -> Any:
    """Return the content of a JSON file; raise OSError if it cannot be read.

    Raises ValueError if it is not UTF-8 or not JSON, names a key twice, or is nested too deeply.
    """
    with _refusing(f"{path} is not a JSON file"):
        return json.loads(Path(path).read_text("utf-8-sig"), object_pairs_hook=_unique_keys)


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the content of a TOML file; errors as of `read_json`."""
    with _refusing(f"{path} is not a TOML file"):
        return tomllib.loads(Path(path).read_text("utf-8-sig"))


@contextmanager
def _refusing(refusal: str) -> Iterator[None]:
    """Begin the message of a ValueError of the block with ``refusal``."""
    try:
        yield
    except RecursionError:
        raise ValueError(f"{refusal}: it is nested too deeply.") from None
    except ValueError as error:
        raise ValueError(f"{refusal}: {error}.") from error


def _unique_keys(pairs):
    content = dict(pairs)
    if len(content) < len(pairs):
        ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"the key {name!r} stands twice")
    return content


def software_versions() -> dict[str, str]:
    """Return the versions of skdgp and of the packages that its numbers depend on."""
    versions = {"skdgp": "unknown", "python": platform.python_version()}
    for name in ("skdgp", "scikit-learn", "numpy", "scipy", "pandas"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # run from a folder that was never installed
            continue
    return versions


def column_names(y) -> list[str]:
    """Return the columns of a dataframe of any library, or the name of a series; empty if they are not all texts."""
    names = list(getattr(y, "columns", [getattr(y, "name", None)]))
    return names if all(isinstance(name, str) and name for name in names) else []


def csv_writer(table: pd.DataFrame) -> Writer:
    """Return the writer of a table as CSV, with every digit."""
    return lambda path: table.to_csv(path, index=False)
