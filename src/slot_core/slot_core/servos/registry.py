"""Registry of the brands of servos: the only module that imports them."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from slot_core import config
from slot_core.config import ConfigError, text
from slot_core.refusal import quoted, read_text
from slot_core.servos.brand import Brand


def _dynamixel() -> Brand:
    from slot_core.dynamixel.brand import DYNAMIXEL  # noqa: PLC0415 - loads the brand's library

    return DYNAMIXEL


BRANDS: dict[str, Callable[[], Brand]] = {"dynamixel": _dynamixel}


@dataclass(frozen=True)
class ServoBusSettings:
    """Contents of `config/servo_bus.yaml`."""

    brand: str = text(f"brand of the servos, one of: {', '.join(BRANDS)}")

    def __post_init__(self) -> None:
        """Raise ConfigError for an unknown brand."""
        if self.brand not in BRANDS:
            raise ConfigError(
                f"brand = {quoted(self.brand)}: expected one of {', '.join(BRANDS)}"
            )


def read_servo_bus() -> ServoBusSettings:
    """The settings of `config/servo_bus.yaml`; raises ConfigError."""
    return config.read(ServoBusSettings, "servo_bus")


def read_brand() -> Brand:
    """The configured brand; raises ConfigError."""
    return BRANDS[read_servo_bus().brand]()


def brand_of_help() -> Brand:
    """The brand that the text of `config/servo_bus.yaml` names, read without PyYAML.

    Raises ConfigError.
    """
    found = re.search(
        r"^brand: *(\w+)",
        read_text(config.config_dir() / "servo_bus.yaml", config.SIZE_MAX),
        re.MULTILINE,
    )
    return BRANDS[ServoBusSettings(found[1] if found else "").brand]()
