"""Messages of refusals are one line, short and printable."""

import datetime
import os

import numpy as np
import pytest

from slot_core.refusal import (
    LINE_MAX,
    VALUE_MAX,
    InputError,
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


def test_a_message_keeps_its_begin_and_its_end_and_a_long_value_is_cut():
    line = str(
        InputError("/bags/one: " + "a\nb\x1b[2J " * 10**6 + "no such topic")
    )
    assert line.startswith(r"/bags/one: a b\x1b[2J")
    assert line.endswith(" no such topic")
    assert line.isprintable()
    assert LINE_MAX - 10 < len(line) <= LINE_MAX
    assert (
        printable("10 \u00b5m a\x9b1mb\tc\u202ed")
        == "10 \u00b5m " + r"a\x9b1mb\tc\u202ed"
    )
    for value in (
        "x" * 10**7,
        [["y" * 50] * 50] * 50,
        np.zeros(10**6),
        {"k": "v" * 99},
    ):
        assert 20 < len(quoted(value)) <= VALUE_MAX


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("directory", "not a regular file"),
        ("device", "not a regular file"),
        ("pipe", "not a regular file"),
        ("long", "more than 10 bytes"),
        ("missing", "missing"),
    ],
)
def test_only_regular_files_are_read_and_only_so_far(tmp_path, name, reason):
    (tmp_path / "directory").mkdir()
    (tmp_path / "device").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "long").write_bytes(bytes(11))
    with pytest.raises((ValueError, OSError), match=reason):
        read_bytes(tmp_path / name, 10)
    assert read_bytes(tmp_path / "long", 11) == bytes(11)
