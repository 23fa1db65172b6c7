"""Findings: facts with their numbers, and the wording of each kind, which stands once, in its row of a table."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from string import Formatter
from typing import Any

MOST_NAMES = 3  # names in a list that is shortened
MOST_FINDINGS = 8  # findings in a text that lists them
SHORT = "short"  # format spec of a shortened list
GROUPED = "grouped"  # format spec of findings that are one text for each kind
ADVICE = "advice"  # format spec of the advice of a finding
OPTIONAL = re.compile(r"\[([^\[\]]*\{[^\[\]]*)\]")  # a part of a template with its fields
FIELD = re.compile(r"\{(\w+)")


class Severity(Enum):
    """Consequence of a finding for who uses a model."""

    NOTE = "note"  # information
    ASSUMPTION = "assumption"  # taken for true, as nothing was told
    WARNING = "warning"  # something to look at
    DOUBT = "doubt"  # no use of the model is judged with "yes"


class Kind(Enum):
    """Base of tables of kinds of findings: a row is ``NAME = statement, advice, severity``.

    The statement is a clause without a stop, the advice whole sentences. Both are templates over
    flight, channel and numbers of the finding: a part in brackets, ``[: {causes}]``, is left out
    where one of its fields is unknown, and the format of a flag is shown where it is true.
    """

    statement: str
    advice: str
    severity: Severity

    def __new__(
        cls, statement: str, advice: str = "", severity: Severity = Severity.WARNING
    ) -> Kind:
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)  # two kinds may have one wording
        member.statement = statement
        member.advice = advice
        member.severity = severity
        return member

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Return the name of the kind, which a saved finding knows it by."""
        return getattr, (type(self), self.name)

    @property
    def label(self) -> str:
        """Name of the kind in metrics.json."""
        return self.name.lower()


class PlainText(Kind):
    """Warnings that have a text and no numbers."""

    MESSAGE = "{text}"


@dataclass(frozen=True, init=False)
class Finding:
    """A finding of a check, a reconstruction, a fit or an evaluation.

    Parameters
    ----------
    code : Kind
        Kind of the finding; rules decide by it.
    flight, channel : str, optional
        Flight and channel that it is about.
    **numbers
        Numbers, names, and further findings that the text shows.
    """

    code: Kind
    flight: Any
    channel: str | None
    numbers: Mapping[str, Any]

    def __init__(self, code: Kind, flight: Any = None, channel: Any = None, **numbers: Any) -> None:
        vars(self).update(code=code, flight=flight, channel=channel, numbers=numbers)

    @property
    def severity(self) -> Severity:
        """Consequence, which follows from the kind."""
        return self.code.severity

    @property
    def clause(self) -> str:
        """The statement as a part of a sentence, such as the reason of a judgement."""
        return self._filled(self.code.statement).removesuffix(".")

    @property
    def advice(self) -> str:
        """What to do, as sentences."""
        return self._filled(self.code.advice)

    @property
    def text(self) -> str:
        """Statement and advice as sentences."""
        clause = self.clause
        if self.code.statement[0].islower():
            clause = clause[0].upper() + clause[1:]
        return f"{clause}. {self.advice}".strip()

    def of_flight(self, flight: Any) -> Finding:
        """Return the finding about a flight."""
        return Finding(self.code, flight, self.channel, **self.numbers)

    def to_dict(self) -> dict[str, Any]:
        """Return it as values for `plain`."""
        return {
            "code": self.code,
            "severity": self.severity.value,
            "flight": self.flight,
            "channel": self.channel,
            "numbers": dict(self.numbers),
            "text": self.text,
        }

    def _filled(self, template: str) -> str:
        """Return a template with the values of the finding."""
        values = {"flight": self.flight, "channel": self.channel, **self.numbers}

        def known_part(match: re.Match) -> str:
            fields = FIELD.findall(match[1])
            return match[1] if all(_is_known(values.get(name)) for name in fields) else ""

        return WORDS.vformat(OPTIONAL.sub(known_part, template), (), values)


def texts_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the text of each finding; of several of one kind and its channels the longest, and the others' number.

    Examples
    --------
    >>> texts_of(Finding(PlainText.MESSAGE, text="late") for _ in range(2))
    ('late. (1 more of this kind)',)
    """
    groups = _groups(findings, lambda finding: (finding.channel, *_named(finding)))
    return tuple(longest.text + others for longest, others in groups)


def clauses_of(findings: Iterable[Finding]) -> str:
    """Return clauses as one sentence without its stop; of several of one kind the longest, and the others' channels."""
    groups = _groups(findings, _named)
    return "; ".join(longest.clause + others for longest, others in groups)


def _named(finding: Finding) -> tuple[Any, str]:
    """Return the text and the channels that a finding of a kind may be told apart by."""
    return finding.numbers.get("text"), str(finding.numbers.get("channels"))


def _groups(
    findings: Iterable[Finding], key: Callable[[Finding], Any]
) -> list[tuple[Finding, str]]:
    """Return the longest finding of each kind and key, and how many others there are, as text."""
    groups: dict[Any, list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.code, key(finding)), []).append(finding)
    texts = []
    for group in groups.values():
        longest = max(group, key=lambda finding: finding.numbers.get("samples", 0))
        channels = dict.fromkeys(str(finding.channel) for finding in group)
        del channels[str(longest.channel)]
        among = f": {shortened(list(channels))}" if channels else ""
        others = f" ({len(group) - 1} more of this kind{among})" if len(group) > 1 else ""
        texts.append((longest, others))
    return texts


def with_codes(findings: Iterable[Finding], *codes: Kind) -> list[Finding]:
    """Return the findings that have one of the codes."""
    return [finding for finding in findings if finding.code in codes]


def shortened(names: Sequence[str], most: int = MOST_NAMES, separator: str = ", ") -> str:
    """Return the first names, and the number of the others."""
    text = separator.join(names[:most])
    n_hidden = len(names) - most
    return f"{text} and {n_hidden} more" if n_hidden > 0 else text


class _Words(Formatter):
    """Formats values of findings.

    Items of a list are joined by its format spec, values of a mapping take it, a pair is a value
    and its standard deviation, a flag is its format spec or nothing, and a finding its clause.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text."""
        if isinstance(value, bool):
            return format_spec if value else ""
        if isinstance(value, Finding):
            return value.advice if format_spec == ADVICE else value.clause
        if isinstance(value, Kind):
            return value.statement
        if isinstance(value, Mapping):
            parts = [f"{name} {self.format_field(value[name], format_spec)}" for name in value]
            return shortened(parts, MOST_FINDINGS)
        if isinstance(value, tuple):
            number, std = value
            unsigned = format_spec.removeprefix("+")
            return f"{self.format_field(number, format_spec)} ± {self.format_field(std, unsigned)}"
        if isinstance(value, list):
            return _listed(value, format_spec)
        text = format(value, format_spec)
        return text.replace("%", " %") if isinstance(value, float) else text


WORDS = _Words()


def _listed(values: list[Any], format_spec: str) -> str:
    """Return a list of names, or of findings, as text."""
    if any(isinstance(value, Finding) for value in values):
        if format_spec == GROUPED:
            return clauses_of(values)
        return shortened([value.clause for value in values], MOST_FINDINGS, "; ")
    if format_spec == SHORT:
        return shortened(values)
    return (format_spec or ", ").join(values)


def _is_known(value: Any) -> bool:
    """Return whether a value is more than None, False, or an empty text or collection."""
    is_empty = isinstance(value, str | Mapping | list) and not value
    return value is not None and value is not False and not is_empty
