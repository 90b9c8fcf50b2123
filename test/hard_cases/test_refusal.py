"""Messages of refusals are one line, short and printable."""

import datetime
import os
import re

import numpy as np
import pytest

from slot_core.refusal import (
    LINE_MAX,
    VALUE_MAX,
    InputError,
    one_line,
    printable,
    quoted,
    read_bytes,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.0, "2.0"),
        (True, "True"),
        ("three", "'three'"),
        ([1, "a"], "[1, 'a']"),
        ("\x1b]0;x\x07", r"'\x1b]0;x\x07'"),
        (2**64, "an integer of 65 bits"),
        ([10**5000], "[an integer of 16610 bits]"),
        (datetime.date(2001, 2, 3), "datetime.date(2001, 2, 3)"),
    ],
)
def test_a_short_value_is_quoted_as_in_python(value, text):
    assert quoted(value) == text


@pytest.mark.parametrize(
    "value", ["x" * 10**7, [["y" * 50] * 50] * 50, np.zeros(10**6), {"k": "v" * 99}]
)
def test_a_long_value_is_cut(value):
    assert 20 < len(quoted(value)) <= VALUE_MAX


def test_a_message_keeps_its_begin_and_its_end():
    line = str(InputError("/bags/one: " + "a\nb\x1b[2J " * 10**6 + "no such topic"))
    assert line.startswith(r"/bags/one: a b\x1b[2J")
    assert line.endswith(" no such topic")
    assert line.isprintable()
    assert LINE_MAX - 10 < len(line) <= LINE_MAX
    assert one_line(ValueError("  a\n\n b ")) == "a b"


def test_text_that_is_printable_stays_as_it_is():
    text = "10 \u00b5m  \u00b12"
    assert printable(text) == text
    assert printable("a\x9b1mb\tc\u202ed") == r"a\x9b1mb\tc\u202ed"


@pytest.mark.parametrize("kind", ["directory", "device", "pipe", "long", "missing"])
def test_only_regular_files_are_read_and_only_so_far(tmp_path, kind):
    path = tmp_path / kind
    if kind == "directory":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "long":
        path.write_bytes(bytes(11))
    reason = "more than 10 bytes" if kind == "long" else "not a regular file"
    with pytest.raises(
        (ValueError, OSError), match=reason if kind != "missing" else re.escape(kind)
    ):
        read_bytes(path, 10)


def test_a_file_of_the_largest_size_is_read(tmp_path):
    (tmp_path / "file").write_bytes(bytes(10))
    assert read_bytes(tmp_path / "file", 10) == bytes(10)
