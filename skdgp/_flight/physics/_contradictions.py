"""Contradictions of flights, with only the channels that are probably wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from skdgp._flight.channels import EARTH_VELOCITY, ELEVONS, MIXED, RATES, VANES
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics._laws import Contradiction, Law, Mistake, stuck_surface
from skdgp._flight.physics._list import (
    CHANNELS,
    EQUALITIES,
    EXCHANGES,
    LAWS,
    MISTAKES,
    RESPONSES,
    SAME,
    SIGNS,
    TURNING,
)
from skdgp._flight.physics._signals import PHYSICS, Signals, signals_of
from skdgp._flight.tables import FlightTable

LONG_FLIGHT = 30.0
"""Shorter flights [s] are judged together with others only, and show no scale or zero: gusts last as long."""


def find_contradictions(flights: FlightTable) -> list[Finding]:
    """Return the laws that flights break, or the mistake of several channels that explains them.

    All flights are judged together, and each of at least 30 s by itself if nothing is found in all.
    """
    findings = _findings_of(flights)
    if findings or len(flights.clock.names) < 2:
        return findings
    for name, flight in flights.flights.items():
        if np.ptp(flight.time) >= LONG_FLIGHT:
            findings += [finding.of_flight(name) for finding in _findings_of(flight)]
    return findings


def confirmed_channels(flights: FlightTable) -> set[str]:
    """Return the channels that an equality of kinematics confirms and no law doubts; of others at most signs show."""
    contradictions, confirmed = _contradictions_in(signals_of(flights, CHANNELS))
    causes = _causes(contradictions, confirmed)
    return confirmed.difference(*[cause.channels for cause in causes])


def _findings_of(flights: FlightTable) -> list[Finding]:
    """Return the contradictions of all rows together, or the mistake without which there is none."""
    signals = signals_of(flights, CHANNELS)
    findings = []
    exchanged = _exchange_in(signals)
    if exchanged is not None:
        signals = exchanged.undone(signals)
        findings.append(exchanged.finding)
    contradictions, confirmed = _contradictions_in(signals)
    for cause, corrected in _candidates(signals, contradictions):
        if not any(law.judge(corrected)[0] for law in chain(*_groups(corrected))):
            return [*findings, cause]
    has_elevons = {*ELEVONS} <= {*flights.table.columns}
    for contradiction in _causes(contradictions, confirmed):
        channels: list[str] = []
        for name in contradiction.channels:
            # elevons make elevator and aileron
            channels += ELEVONS if has_elevons and name in MIXED else [name]
        named = replace(contradiction, channels=tuple(dict.fromkeys(channels)))
        findings.append(named.finding)
    if not contradictions:
        stuck = [stuck_surface(name, law, signals) for name, law in RESPONSES.items()]
        findings += [finding for finding in stuck if finding is not None]
    return findings


def _candidates(
    signals: Signals, contradictions: list[Contradiction]
) -> Iterator[tuple[Finding, Signals]]:
    """Yield mistakes that several contradictions may follow from, each with the signals without it.

    Channels are late together by a lag that one of the contradictions shows.
    """
    scaled = [each for each in contradictions if _may_be_of_clock(each)]
    of_scaled = {name for each in scaled for name in each.channels}
    rates = of_scaled & {*RATES}
    # one gyro alone may have another scale
    if len(rates) > 1 or (rates and not of_scaled.isdisjoint(EARTH_VELOCITY)):
        clearest = min(scaled, key=lambda each: each.slope.std)
        factor = clearest.slope.value
        yield (
            Finding(Code.WRONG_CLOCK, rate=signals.rate, true_rate=signals.rate / factor),
            replace(signals, step=factor * signals.step),
        )
    lags = [abs(each.lag[0]) for each in contradictions if each.lag is not None]
    is_turned = any(each.law is TURNING for each in contradictions)
    are_several = is_turned or len(contradictions) >= 3
    doubted = {name for each in contradictions for name in each.channels}
    for mistake in MISTAKES:
        own = mistake.of(signals)
        if len(own.channels) < 2 or doubted.isdisjoint(own.channels):
            continue
        candidates = []
        if own.late and len(lags) > 1:
            candidates = [replace(own, lag=lag) for lag in sorted({*lags})]
        elif not own.late and (are_several or not own.turned):
            candidates = [own]
        for candidate in candidates:
            yield candidate.finding, candidate.undone(signals)


def _may_be_of_clock(contradiction: Contradiction) -> bool:
    """Return whether the slope of clear signals that clocks scale is a possible factor of one, up to 3 (guess)."""
    is_scaled = contradiction.law.admissible is SAME and contradiction.lag is None
    slope = contradiction.slope
    is_clear = slope.correlation > PHYSICS.clear_correlation
    return is_scaled and is_clear and 1 / 3 < slope.value < 3


def _exchange_in(signals: Signals) -> Mistake | None:
    """Return the exchange after which the fewest laws are broken, None if none shows."""
    shown = [mistake for mistake in EXCHANGES if mistake.is_shown(signals)]
    return min(shown, key=lambda mistake: _n_broken(mistake.undone(signals)), default=None)


def _n_broken(signals: Signals) -> int:
    """Return the number of laws that signals break."""
    return len(_contradictions_in(signals)[0])


def _groups(signals: Signals) -> tuple[tuple[Law, ...], ...]:
    """Return the laws in the order of their judgement; of short flights without scales and zeros."""
    return LAWS if signals.step * len(signals.segment) >= LONG_FLIGHT else LAWS[:-1]


def _contradictions_in(signals: Signals) -> tuple[list[Contradiction], set[str]]:
    """Return all contradictions of signals, and the channels that an equality confirms.

    Others may be consequences of the first. Equalities and signs have the clearest first, and turns last, as a
    single channel explains these.
    """
    contradictions: list[Contradiction] = []
    confirmed: set[str] = set()
    for laws in _groups(signals):
        of_group = []
        for law in laws:
            contradiction, is_equal = law.judge(signals)
            if contradiction is not None:
                of_group.append(contradiction)
            elif is_equal:
                confirmed.update(law.channels)
        if laws in (EQUALITIES, SIGNS):
            of_group.sort(key=lambda item: (item.law is TURNING, -abs(item.slope.correlation)))
        contradictions += of_group
    return contradictions, confirmed


def _causes(contradictions: list[Contradiction], confirmed: set[str]) -> list[Contradiction]:
    """Return contradictions with only their suspects, without those that follow from the ones before.

    A contradiction follows if it uses a suspect of an earlier one, or a vane beside another that is late, or has
    no further suspect.
    """
    counts: Counter[str] = Counter()
    for contradiction in contradictions:
        counts.update(contradiction.channels)
    # in a narrow band a lag looks like the other sign
    late = {each.channels: each for each in contradictions if each.lag is not None}
    accused: set[str] = set()
    doubted: set[str] = set()
    causes = []
    for each in contradictions:
        contradiction = late.get(each.channels, each)
        suspects = _suspects(contradiction, confirmed - accused, counts)
        law = contradiction.law
        uses_doubted = not doubted.isdisjoint((*law.uses, *law.beside))
        if not uses_doubted and not accused.issuperset(suspects):
            accused.update(suspects)
            doubted.update(suspects)
            if contradiction.lag is not None and not doubted.isdisjoint(VANES):
                doubted.update(VANES)  # both are read by one computer
            causes.append(replace(contradiction, channels=suspects))
    return causes


def _suspects(
    contradiction: Contradiction, confirmed: set[str], counts: Counter[str]
) -> tuple[str, ...]:
    """Return the channels of a contradiction that no equality confirms, of several the most often contradicted ones.

    All channels count where all are confirmed, and of a lag: either of two signals may be late.
    """
    channels = contradiction.channels
    if contradiction.lag is None and not confirmed.issuperset(channels):
        channels = tuple(name for name in channels if name not in confirmed)
    most = max(counts[name] for name in channels)
    return tuple(name for name in channels if counts[name] == most)
