"""Settings of `config/twin.yaml`."""

from dataclasses import dataclass

from slot_core import config
from slot_core.config import quantity


@dataclass(frozen=True)
class TwinSettings:
    """How the motion of a bag is predicted by the simulated robot and compared with it."""

    hold: float = quantity(
        "time between two tendon angles given to the robot", "s", 2e-3, 0.05
    )
    command_delay: float = quantity(
        "from a command's stamp to its effect", "s", 0.0, 0.5
    )
    run_in: int = quantity(
        "strides after the first motion that are not compared", "", 0, 1000
    )
    least_motion_deg: float = quantity(
        "range of a tendon angle in a stride; below it the robot stands",
        "deg",
        0.0,
        90.0,
    )
    window: int = quantity(
        "strides predicted from one measured place and heading", "", 1, 1000
    )
    held_out: float = quantity(
        "share of the strides, the last, that a fit does not see", "", 0, 0.9
    )
    position_sigma: float = quantity(
        "standard uncertainty of a position", "m", 1e-6, 1.0
    )
    angle_sigma: float = quantity(
        "standard uncertainty of roll, pitch, yaw", "rad", 1e-6, 1.0
    )


def read_twin() -> TwinSettings:
    """Read `config/twin.yaml`; raises ConfigError."""
    return config.read(TwinSettings, "twin")
