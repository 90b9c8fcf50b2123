"""Control table against the one that ships with the SDK."""

from pathlib import Path

import dynamixel_easy_sdk
import pytest

from slot_core.dynamixel.table import TABLE, decode_span, span

MODEL = Path(dynamixel_easy_sdk.__file__).parent / "control_table" / "xl430_w250.model"
NAMES = {"secondary(shadow)_id": "secondary_id"}


def sdk_rows():
    rows = MODEL.read_text().split("[control table]")[1].strip().splitlines()[1:]
    for row in rows:
        address, size, name = row.split("\t")
        name = name.strip().lower().replace(" ", "_")
        if not name.endswith(("_write", "_read")):  # additional names of the SDK
            yield NAMES.get(name, name), int(address), int(size)


def test_addresses_and_sizes_equal_those_of_the_sdk():
    rows = list(sdk_rows())
    assert len(rows) > 45
    for name, address, size in rows:
        assert (TABLE[name].address, TABLE[name].size) == (address, size), name


def test_negative_values_are_twos_complement():
    assert TABLE["present_position"].decode(b"\xff\xff\xff\xff") == -1
    assert TABLE["goal_pwm"].encode(-885) == b"\x8b\xfc"
    with pytest.raises(ValueError, match="3 bytes, expected 4"):
        TABLE["present_position"].decode(b"\0\0\0")


def test_decode_span_leaves_out_partly_covered_registers():
    address, size = span("present_load", "present_position")
    assert (address, size) == (126, 10)
    data = (
        b"\xff\xff"
        + (-3).to_bytes(4, "little", signed=True)
        + (253).to_bytes(4, "little")
    )
    assert decode_span(126, data) == {
        "present_load": -1,
        "present_velocity": -3,
        "present_position": 253,
    }
    assert set(decode_span(127, data[1:-1])) == {"present_velocity"}
