"""Control table against the one that ships with the SDK."""

from pathlib import Path

import dynamixel_easy_sdk

from slot_core.dynamixel.table import TABLE, decode_span, span

MODEL = (
    Path(dynamixel_easy_sdk.__file__).parent
    / "control_table"
    / "xl430_w250.model"
)
NAMES = {"secondary(shadow)_id": "secondary_id"}


def test_addresses_and_sizes_equal_those_of_the_sdk():
    rows = (
        MODEL.read_text().split("[control table]")[1].strip().splitlines()[1:]
    )
    assert len(rows) > 45
    for row in rows:
        address, size, name = row.split("\t")
        name = name.strip().lower().replace(" ", "_")
        # additional names of the SDK
        if not name.endswith(("_write", "_read")):
            register = TABLE[NAMES.get(name, name)]
            assert (register.address, register.size) == (
                int(address),
                int(size),
            ), name


def test_a_span_is_decoded_in_twos_complement_without_registers_partly_covered():
    address, size = span("present_load", "present_position")
    assert (address, size) == (126, 10)
    data = b"\xff\xff" + b"\xfd\xff\xff\xff" + b"\xfd\0\0\0"
    assert decode_span(126, data) == {
        "present_load": -1,
        "present_velocity": -3,
        "present_position": 253,
    }
    assert set(decode_span(127, data[1:-1])) == {"present_velocity"}
