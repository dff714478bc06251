"""Reasons of errors, in the words of a sentence. That files appear whole or not at all is tested by `test_store`."""

import pytest

from clunk.results.files import reason


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device"), "no space left on device"),
        (ValueError("Two\n  lines."), "two lines"),
        (MemoryError(), "MemoryError"),
    ],
)
def test_a_reason_can_stand_within_a_sentence(error, words):
    assert reason(error).lower() == words.lower()
