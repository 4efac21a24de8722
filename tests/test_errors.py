"""What a message quotes is cut and printable, wherever the message is made."""

import pytest

from polarmap.errors import LONGEST_MESSAGE, LONGEST_QUOTE, InputError, PolarmapError, concise, quoted


def test_a_short_message_stays_as_it_is():
    message = "camera.yaml: fx: 'wide' cannot be used; write a finite number  (in pixels) – φ, 深"
    assert str(InputError(message)) == message == str(PolarmapError(message))


@pytest.mark.parametrize("filling", ["x" * 5000, "x " * 5000, "\n" * 5000, "\x1b[31m" * 900, "\ud800" * 5000])
def test_what_is_between_the_file_and_the_remedy_is_cut(filling):
    message = str(InputError(f"/data/camera.yaml, line 3: '{filling}' is no number; write one such as 1.5"))
    assert message.startswith("/data/camera.yaml, line 3: '") and message.endswith("write one such as 1.5")
    assert len(message) <= LONGEST_MESSAGE and message.isprintable()
    message.encode()


def test_a_long_path_keeps_its_begin_and_its_name():
    path = "/data/" + "folder/" * 500 + "camera.yaml"
    message = str(InputError(f"{path}: no such file"))
    assert message.startswith("/data/folder/") and message.endswith("folder/camera.yaml: no such file")
    assert len(message) < LONGEST_QUOTE + 20


def test_concise_is_at_rest():
    once = concise("a" * 1000 + " b" * 1000)
    assert concise(once) == once


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("wide", "'wide'"),
        (b"wide", "b'wide'"),
        (1.5, "1.5"),
        (True, "True"),
        (None, "None"),
        (10**5000, "an integer of 16610 bits"),
        ([[1] * 10**6], "a list"),
        ({"a": 1}, "a mapping"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_quoted(value, text):
    assert quoted(value) == text


@pytest.mark.parametrize("value", ["x" * 10**6, b"x" * 10**6, "\0" * 500, 10**4000], ids=range(4))
def test_quotes_are_cut(value):
    assert len(quoted(value)) <= LONGEST_QUOTE
