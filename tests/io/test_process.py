"""Signals are noted, and acted on when they come again."""

import signal

import pytest

from moveset.io.process import noted_signals


def test_signals_of_two_kinds_are_noted_and_a_second_of_one_interrupts():
    """A terminal's Ctrl-C reaches trainings side by side, which the process that began them then ends by SIGTERM."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with noted_signals() as received:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert received == [signal.SIGINT, signal.SIGTERM]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert {number: signal.getsignal(number) for number in before} == before
